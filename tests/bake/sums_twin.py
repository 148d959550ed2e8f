"""The sums over pixels and the texture equations of a bake in float64 NumPy.

They are the twin of bake.cl, bake_texture.cl and bake_solve.cl.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera
from tests.reference.standard import weights_at

Reals = NDArray[np.float64]


class Drawn(NamedTuple):
    """An image of a soup: colours (H, W, 3), depths along z (H, W), and the face of each pixel, or -1."""

    image: Reals
    depth: Reals
    face_id: NDArray[np.int32]


class Sums(NamedTuple):
    """Sums per face: products of weights, of weights and colours, gradients (F, 3, 3), and pixels (F,)."""

    products: Reals
    targets: Reals
    gradients: Reals
    pixels: NDArray[np.int64]


def sums_of(corners: Reals, camera: Camera, drawn: Drawn, target: Reals) -> Sums:
    """Return the sums over the pixels of faces (F, 3, 3) for a target image (H, W, 3)."""
    count = len(corners)
    products, targets, gradients = np.zeros((3, count, 3, 3))
    pixels = np.zeros(count, np.int64)
    pose = camera.world_to_camera
    local = corners.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    focal, principal = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    for y, x in zip(*np.nonzero(drawn.face_id >= 0), strict=True):
        face = drawn.face_id[y, x]
        at = (np.array([x, y]) + 0.5 - principal) / focal
        weights = weights_at(local[face], np.array([[*at, 1.0]]))[0]
        pixels[face] += 1
        products[face] += np.outer(weights, weights)
        targets[face] += np.outer(weights, target[y, x])
        # The motion of a point of the scene on the screen: u = fx X / Z + cx.
        motion = focal[:, None] * (pose[:2, :3] - at[:, None] * pose[2, :3]) / drawn.depth[y, x]
        gradients[face] += np.outer(weights, _border_gradient(drawn, target, y, x) @ motion)
    return Sums(products, targets, gradients, pixels)


def _border_gradient(drawn: Drawn, target: Reals, y: int, x: int) -> Reals:
    """Return the derivatives (2,) of the squared error by moves of a face's borders along x and y."""
    image, depth, faces = drawn
    gradient = np.zeros(2)
    for axis, (down, right) in enumerate(((0, 1), (1, 0))):
        for step in (-1, 1):
            other = y + step * down, x + step * right
            if not (0 <= other[0] < faces.shape[0] and 0 <= other[1] < faces.shape[1]):
                continue
            is_behind = faces[other] < 0 or depth[other] > depth[y, x]
            if faces[other] == faces[y, x] or not is_behind:
                continue
            outward = _error(image[y, x], target[other]) - _error(image[other], target[other])
            inward = _error(image[other], target[y, x]) - _error(image[y, x], target[y, x])
            gradient[axis] += step * (outward - inward) / 2
    return gradient


def changes_of(before: Drawn, after: Drawn, target: Reals, owner: NDArray[np.int32], proposals: int) -> Reals:
    """Return how each proposal changes the squared error; `owner` (F,) has the proposal of a face, or -1."""
    changes = np.zeros(proposals)
    for y, x in np.ndindex(*before.face_id.shape):
        rise = _error(after.image[y, x], target[y, x]) - _error(before.image[y, x], target[y, x])
        faces = (drawn.face_id[y, x] for drawn in (before, after))
        owners = {int(owner[face]) for face in faces if face >= 0 and owner[face] >= 0}
        for proposal in owners:
            changes[proposal] += rise / len(owners)
    return changes


def _error(color: Reals, target: Reals) -> float:
    return float(np.square(color - target).sum())


class Samples(NamedTuple):
    """The texels that pixels blend, with a row for each mip level that a pixel uses."""

    pixel: NDArray[np.int64]
    """(n,) the number of the pixel."""
    texels: NDArray[np.int64]
    """(n, 4) the numbers of the four texels."""
    blend: Reals
    """(n, 4) the weight of each texel in the level; the sum is 1."""
    share: Reals
    """(n,) the weight of the level in the pixel."""


def samples_of(
    corners: Reals, uvs: Reals, sides: NDArray[np.int64], camera: Camera, face_id: NDArray[np.int32]
) -> Samples:
    """Return the samples of the pixels that show faces, `face_id` (H, W), in levels with these `sides`.

    Each corner of a face has a vector; its dot product with a ray is the unnormalised weight of the corner.
    Let C be the sum of the three vectors. Let U be their sum, weighted by the texture coordinates of the
    corners. Along a ray r the texture coordinate is then (U . r) / (C . r), and its derivatives are exact.
    """
    y, x = np.nonzero(face_id >= 0)
    face = face_id[y, x]
    pose = camera.world_to_camera
    points = corners[face].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    vectors = np.cross(points[:, [1, 2, 0]], points[:, [2, 0, 1]])
    coordinates = uvs[face].astype(np.float64) * sides[0]
    rays = np.stack([(x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, np.ones(len(x))])
    below = vectors.sum(axis=1)
    bottom = (below * rays.T).sum(axis=1)
    place, steps = [], np.zeros((2, len(x)))
    for axis in (0, 1):
        above = (coordinates[:, :, axis, None] * vectors).sum(axis=1)
        at = (above * rays.T).sum(axis=1) / bottom
        for k, focal in enumerate((camera.fx, camera.fy)):
            steps[k] += np.square((above[:, k] - at * below[:, k]) / (bottom * focal))
        place.append(np.clip(at, *(bound(coordinates[..., axis], axis=1) for bound in (np.min, np.max))))
    lod = np.clip(0.5 * np.log2(np.maximum(steps.max(axis=0), 1)), 0, len(sides) - 1)
    starts = np.concatenate([[0], np.cumsum(sides**2)])
    rows = []
    for above in (0, 1):
        level = np.minimum(lod.astype(np.int64) + above, len(sides) - 1)
        side = sides[level]
        at = [np.clip(axis * side / sides[0] - 0.5, 0, side - 1) for axis in place]
        column, row = (np.minimum(axis.astype(np.int64), side - 2) for axis in at)
        right, down = at[0] - column, at[1] - row
        first = starts[level] + row * side + column
        blend = [(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down]
        share = lod % 1 if above else 1 - lod % 1
        texels = np.stack([first, first + 1, first + side, first + side + 1], axis=1)
        rows.append((y * camera.width + x, texels, np.stack(blend, axis=1), share))
    return Samples(*(np.concatenate(columns) for columns in zip(*rows, strict=True)))


def equations_of(samples: Samples, differences: Reals, count: int) -> Reals:
    """Return the equations (count, 8) of texels; `differences` (H W, 3) are target minus image.

    A row has five sums of products: the weight of a texel times that of itself and of the texels to the
    right, below, below right and below left. Its last three values are the right sides.
    """
    equations = np.zeros((count, 8))
    pixel, texels, blend, share = samples
    for corner in range(4):
        weight = share * blend[:, corner]
        np.add.at(equations[:, 5:], texels[:, corner], weight[:, None] * differences[pixel])
    pairs = {
        0: [(0, 0), (1, 1), (2, 2), (3, 3)],
        1: [(0, 1), (2, 3)],
        2: [(0, 2), (1, 3)],
        3: [(0, 3)],
        4: [(1, 2)],
    }
    for place, ends in pairs.items():
        for start, end in ends:
            np.add.at(equations[:, place], texels[:, start], share * blend[:, start] * blend[:, end])
    return equations


def apply_equations(equations: Reals, sides: NDArray[np.int64], change: Reals) -> Reals:
    """Return the left sides (texels, channels) of the equations for a change of a texture.

    `sides` are the sides of its levels.
    """
    parts: list[Reals] = []
    for level, side in zip(_split_levels(equations, sides), sides, strict=True):
        if parts:
            change = change.reshape(side, 2, side, 2, -1).mean(axis=(1, 3)).reshape(side**2, -1)
        center, *others = level[:, :5].T[..., None]
        product = center * change
        # Texels are numbered row by row, so a step in the numbers leads to a neighbour. Texels at the border
        # have no coupling across it.
        for plane, step in zip(others, (1, side, side + 1, side - 1), strict=True):
            product[:-step] += plane[:-step] * change[step:]
            product[step:] += plane[:-step] * change[:-step]
        parts.append(product)
    return _restrict(parts, 1 / 4)


def solve_equations(equations: Reals, sides: NDArray[np.int64], steps: int) -> Reals:
    """Return the change (texels, 3) after some steps of conjugate gradients with Jacobi's preconditioner."""
    levels = _split_levels(equations, sides)
    diagonal = _restrict([level[:, :1] for level in levels], 1 / 16)
    scale = _divide(np.ones_like(diagonal), diagonal)
    residual = _restrict([level[:, 5:] for level in levels], 1 / 4)
    change, direction = np.zeros_like(residual), np.zeros_like(residual)
    size = np.full(3, np.inf)
    for _ in range(steps):
        before, size = size, (scale * residual**2).sum(axis=0)
        direction = scale * residual + _divide(size, before) * direction
        product = apply_equations(equations, sides, direction)
        length = _divide(size, (direction * product).sum(axis=0))
        change += length * direction
        residual -= length * product
    return change


def _divide(above: Reals, below: Reals) -> Reals:
    quotient: Reals = np.divide(above, below, out=np.zeros_like(above), where=below > 0)
    return quotient


def _split_levels(equations: Reals, sides: NDArray[np.int64]) -> list[Reals]:
    levels: list[Reals] = np.split(equations, np.cumsum(sides**2)[:-1])
    return levels


def _restrict(parts: list[Reals], share: float) -> Reals:
    """Return the sums over all levels at the texels of the first level.

    The value of a texel is multiplied by `share` and added to the four texels below it in the next larger
    level.
    """
    total = parts[-1]
    for part in parts[-2::-1]:
        half = np.sqrt(len(total)).astype(int)
        blocks = part.reshape(half, 2, half, 2, -1)
        total = (blocks + share * total.reshape(half, 1, half, 1, -1)).reshape(part.shape)
    return total
