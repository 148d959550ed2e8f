"""What a bake sums over a picture, in float64 NumPy, pixel by pixel: the twin of bake.cl."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.reference.standard import weights_at

if TYPE_CHECKING:
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
