"""What a bake sums over a picture, in float64 NumPy: the twin of bake.cl, bake_texture.cl
and bake_solve.cl."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.reference.standard import weights_at
from msb.scenes import Camera

Reals = NDArray[np.float64]


class Drawn(NamedTuple):
    """A picture of a soup: (H, W, 3) colours, (H, W) depth along z, and the face of each pixel, -1 for
    none."""

    image: Reals
    depth: Reals
    face_id: NDArray[np.int32]


class Sums(NamedTuple):
    """Of each face: products of weights (F, 3, 3), weights times colours (F, 3, 3), slopes (F, 3, 3),
    pixels."""

    products: Reals
    sides: Reals
    slopes: Reals
    pixels: NDArray[np.int64]


def sums_of(corners: Reals, camera: Camera, drawn: Drawn, lesson: Reals) -> Sums:
    """Return what a picture, held against what the lesson shows (H, W, 3), says of faces (F, 3, 3)."""
    count = len(corners)
    products, sides, slopes = np.zeros((3, count, 3, 3))
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
        sides[face] += np.outer(weights, lesson[y, x])
        # How a point of the scene moves on the screen: u = fx X / Z + cx.
        turned = focal[:, None] * (pose[:2, :3] - at[:, None] * pose[2, :3]) / drawn.depth[y, x]
        slopes[face] += np.outer(weights, _slope(drawn, lesson, y, x) @ turned)
    return Sums(products, sides, slopes, pixels)


def _slope(drawn: Drawn, lesson: Reals, y: int, x: int) -> Reals:
    """Return how the squared error rises as the borders of a pixel's face move along x and along y, (2,)."""
    image, depth, faces = drawn
    found = np.zeros(2)
    for axis, (down, right) in enumerate(((0, 1), (1, 0))):
        for step in (-1, 1):
            other = y + step * down, x + step * right
            if not (0 <= other[0] < faces.shape[0] and 0 <= other[1] < faces.shape[1]):
                continue
            is_behind = faces[other] < 0 or depth[other] > depth[y, x]
            if faces[other] == faces[y, x] or not is_behind:
                continue
            outward = _error(image[y, x], lesson[other]) - _error(image[other], lesson[other])
            inward = _error(image[other], lesson[y, x]) - _error(image[y, x], lesson[y, x])
            found[axis] += step * (outward - inward) / 2
    return found


def booked(before: Drawn, after: Drawn, lesson: Reals, owner: NDArray[np.int32], proposals: int) -> Reals:
    """Return by how much the squared error rises by each proposal, whose faces `owner` (F,) says, -1 for
    none."""
    found = np.zeros(proposals)
    for y, x in np.ndindex(*before.face_id.shape):
        rise = _error(after.image[y, x], lesson[y, x]) - _error(before.image[y, x], lesson[y, x])
        faces = (each.face_id[y, x] for each in (before, after))
        owners = {int(owner[face]) for face in faces if face >= 0 and owner[face] >= 0}
        for one in owners:
            found[one] += rise / len(owners)
    return found


def _error(seen: Reals, wanted: Reals) -> float:
    return float(np.square(seen - wanted).sum())


class Samples(NamedTuple):
    """What pixels show of a square texture and its smaller levels, a row for each level that a pixel shows:
    the pixel, its four texels (n, 4) in rows, and how much of its value they have (n, 4), 1 in all."""

    pixel: NDArray[np.int64]
    texels: NDArray[np.int64]
    blend: Reals
    share: Reals
    """(n,) of the level in the pixel's value."""


def samples_of(
    corners: Reals, uvs: Reals, sides: NDArray[np.int64], camera: Camera, shown: NDArray[np.int32]
) -> Samples:
    """Return what the pixels that show faces, `shown` (H, W), have of a texture whose levels have these
    `sides`.

    Along a ray r a texture coordinate is U r / C r, with C the sum of the vectors that give the weights of
    a face's corners (F, 3, 3), and U their sum weighted by the corners' coordinates (F, 3, 2); so are its
    derivatives exact.
    """
    y, x = np.nonzero(shown >= 0)
    face = shown[y, x]
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
    found = []
    for above in (0, 1):
        level = np.minimum(lod.astype(np.int64) + above, len(sides) - 1)
        side = sides[level]
        at = [np.clip(one * side / sides[0] - 0.5, 0, side - 1) for one in place]
        column, row = (np.minimum(one.astype(np.int64), side - 2) for one in at)
        right, down = at[0] - column, at[1] - row
        first = starts[level] + row * side + column
        blend = [(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down]
        share = lod % 1 if above else 1 - lod % 1
        texels = np.stack([first, first + 1, first + side, first + side + 1], axis=1)
        found.append((y * camera.width + x, texels, np.stack(blend, axis=1), share))
    return Samples(*(np.concatenate(each) for each in zip(*found, strict=True)))


def asked_of(samples: Samples, lacks: Reals, count: int) -> Reals:
    """Return what samples of pixels that lack `lacks` (H W, 3) ask of `count` texels, (count, 8): products of
    a texel's weights with its own, with those of the right one, the one below, below right and below left,
    and right sides."""
    equations = np.zeros((count, 8))
    pixel, texels, blend, share = samples
    for corner in range(4):
        mine = share * blend[:, corner]
        np.add.at(equations[:, 5:], texels[:, corner], mine[:, None] * lacks[pixel])
    pairs = {
        0: [(0, 0), (1, 1), (2, 2), (3, 3)],
        1: [(0, 1), (2, 3)],
        2: [(0, 2), (1, 3)],
        3: [(0, 3)],
        4: [(1, 2)],
    }
    for place, ends in pairs.items():
        for one, other in ends:
            np.add.at(equations[:, place], texels[:, one], share * blend[:, one] * blend[:, other])
    return equations


def applied(equations: Reals, sides: NDArray[np.int64], change: Reals) -> Reals:
    """Return the left sides (texels, channels) for a change of a texture whose levels have these `sides`."""
    parts: list[Reals] = []
    for level, side in zip(_by_level(equations, sides), sides, strict=True):
        if parts:
            change = change.reshape(side, 2, side, 2, -1).mean(axis=(1, 3)).reshape(side**2, -1)
        center, *others = level[:, :5].T[..., None]
        made = center * change
        # In rows one after the other: a texel at the border is not tied beyond it.
        for plane, step in zip(others, (1, side, side + 1, side - 1), strict=True):
            made[:-step] += plane[:-step] * change[step:]
            made[step:] += plane[:-step] * change[:-step]
        parts.append(made)
    return _spread(parts, 1 / 4)


def solved(equations: Reals, sides: NDArray[np.int64], steps: int) -> Reals:
    """Return the change (texels, 3) after so many steps of conjugate gradients, with Jacobi's
    preconditioner."""
    levels = _by_level(equations, sides)
    diagonal = _spread([level[:, :1] for level in levels], 1 / 16)
    scale = _quotient(np.ones_like(diagonal), diagonal)
    residual = _spread([level[:, 5:] for level in levels], 1 / 4)
    change, direction = np.zeros_like(residual), np.zeros_like(residual)
    size = np.full(3, np.inf)
    for _ in range(steps):
        before, size = size, (scale * residual**2).sum(axis=0)
        direction = scale * residual + _quotient(size, before) * direction
        moved = applied(equations, sides, direction)
        length = _quotient(size, (direction * moved).sum(axis=0))
        change += length * direction
        residual -= length * moved
    return change


def _quotient(above: Reals, below: Reals) -> Reals:
    found: Reals = np.divide(above, below, out=np.zeros_like(above), where=below > 0)
    return found


def _by_level(equations: Reals, sides: NDArray[np.int64]) -> list[Reals]:
    levels: list[Reals] = np.split(equations, np.cumsum(sides**2)[:-1])
    return levels


def _spread(parts: list[Reals], share: float) -> Reals:
    """Return the sum of what levels have: a texel gets `share` of that which it is part of."""
    total = parts[-1]
    for part in parts[-2::-1]:
        half = np.sqrt(len(total)).astype(int)
        own = part.reshape(half, 2, half, 2, -1)
        total = (own + share * total.reshape(half, 1, half, 1, -1)).reshape(part.shape)
    return total
