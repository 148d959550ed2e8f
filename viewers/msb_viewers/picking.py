"""Find the face and vertex under a pixel, in NumPy. This module needs no OpenGL."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Hit:
    """The first hit of a ray: the face, its corner nearest to the ray, and the distance along the ray."""

    face: int
    vertex: int
    distance: float


def pick(
    points: NDArray[np.float32],
    faces: NDArray[Any],
    allowed: NDArray[np.bool_],
    eye: NDArray[Any],
    direction: NDArray[Any],
    box: NDArray[Any] | None = None,
) -> Hit | None:
    """Return the first of the `allowed` faces (F,) that a ray from `eye` along a unit vector hits.

    Hits outside the box `box` (3, 2) do not count. The function takes O(V + F) time and 13 V + 4 F bytes of
    memory.
    """
    if not allowed.any():
        return None
    direction = np.asarray(direction, np.float64)
    # Project the vertices along the ray onto a plane with two axes. If the ray hits a face, then along each
    # axis the face has vertices on both sides of the ray. For each vertex, two bits store the side of the ray
    # along the two axes.
    side = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(direction, side), direction], axis=1)
    across = (points - np.asarray(eye, np.float32)) @ frame[:, :2].astype(np.float32)
    code = (across[:, 0] > 0).astype(np.uint8) | ((across[:, 1] > 0).astype(np.uint8) << 1)
    a, b, c = code[faces[:, 0]], code[faces[:, 1]], code[faces[:, 2]]
    around = ((a & b & c) == 0) & ((a | b | c) == 3) & allowed
    rows = np.flatnonzero(around)
    if len(rows) == 0:
        return None
    # Intersect the remaining faces (n, 3, 3) with the ray in float64.
    local = (points[faces[rows]].astype(np.float64) - np.asarray(eye, np.float64)) @ frame
    u, v, t = local[..., 0], local[..., 1], local[..., 2]
    sides = u * np.roll(v, -1, axis=1) - v * np.roll(u, -1, axis=1)  # edge functions for the edges 01, 12, 20
    area = sides.sum(axis=1)
    inside = ((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)) & (area != 0)
    weights = np.roll(sides, -1, axis=1)[inside] / area[inside, None]
    depth = (weights * t[inside]).sum(axis=1)
    rows, local = rows[inside], local[inside]
    # Take the nearest hit in front of the eye and inside the box.
    keep = depth > 0
    if box is not None:
        met = np.asarray(eye, np.float64) + depth[:, None] * direction
        keep &= ((met >= box[:, 0]) & (met <= box[:, 1])).all(axis=1)
    if not keep.any():
        return None
    first = int(np.argmin(np.where(keep, depth, np.inf)))
    corner = int(np.argmin((local[first, :, :2] ** 2).sum(axis=1)))
    face = int(rows[first])
    return Hit(face, int(faces[face, corner]), float(depth[first]))
