"""Votes of views on which places are solid, in NumPy, view by view. This is the twin of bake_fuse.cl."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera

Reals = NDArray[np.float64]


def vote(
    places: Reals,
    reach: Reals,
    behind: Reals,
    cameras: Sequence[Camera],
    depths: Sequence[NDArray[np.floating]],
    share: float,
    thick: float,
) -> Reals:
    """Return the votes (n,) on places (n, 3) of the world; NaN if no view contains a place.

    A vote is the average distance of a place in front of the visible surface, minus `thick`. Distances are
    along z, in units of `reach` (n,), and at most 1. `depths` are maps (H, W), 0 for the background.

    A place more than `behind` (n,) behind the surface is hidden from a view. Consider the number of views
    that see a place, divided by the number of views from which it is hidden. If this ratio is below `share`,
    the place is solid and its vote is -1. If the ratio is between `share` and twice `share`, the vote is
    interpolated.
    """
    total, seen, hidden = np.zeros((3, len(places)))
    for camera, depth in zip(cameras, depths, strict=True):
        pixels, away = camera.project(places)
        u, v = pixels.T
        inside = (away > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        for i in np.flatnonzero(inside):
            surface = _depth_at(depth.astype(np.float64), u[i], v[i], reach[i])
            before = (surface - away[i]) / reach[i] if surface > 0 else 1.0
            if before * reach[i] < -behind[i]:
                hidden[i] += 1
            else:
                total[i] += min(before, 1.0)
                seen[i] += 1
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / seen
        doubt = np.clip(2 * share * hidden / seen - 1, 0, 1)
        mean = np.maximum(mean - doubt * (mean + 1) - thick, -1)
    return np.where(seen > 0, mean, np.where(hidden > 0, -1.0, np.nan))


def _depth_at(depth: Reals, u: float, v: float, reach: float) -> float:
    """Return the depth at a place (u, v) of the image.

    If the four pixels around it show one surface, it is interpolated.
    """
    nearest = float(depth[int(v), int(u)])
    height, width = depth.shape
    column = min(max(int(np.floor(u - 0.5)), 0), width - 2)
    row = min(max(int(np.floor(v - 0.5)), 0), height - 2)
    four = depth[row : row + 2, column : column + 2]
    if nearest <= 0 or four.min() <= 0 or four.max() - four.min() >= reach:
        return nearest
    right, down = (float(np.clip(x, 0, 1)) for x in (u - 0.5 - column, v - 0.5 - row))
    return float(np.array([1 - down, down]) @ four @ np.array([1 - right, right]))
