"""A vote of views on what is solid, in NumPy, view by view: the twin of bake_fuse.cl."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera

Reals = NDArray[np.float64]


def fused(
    places: Reals,
    reach: Reals,
    behind: Reals,
    cameras: Sequence[Camera],
    depths: Sequence[NDArray[np.floating]],
    share: float,
    thick: float,
) -> Reals:
    """Return how far places (n, 3) of the world lie before what cameras see, in the mean and less `thick`,
    (n,); NaN where no view has one in its picture.

    Distances are along z, in units of `reach` (n,), and cut at 1; `depths` are (H, W), 0 where nothing is
    seen. From views that find a place farther than `behind` (n,) that it is hidden. It is solid, -1, if it is
    seen by fewer views than `share` of these, and partly so if by fewer than twice as many.
    """
    total, seen, hidden = np.zeros((3, len(places)))
    for camera, depth in zip(cameras, depths, strict=True):
        pixels, away = camera.project(places)
        u, v = pixels.T
        inside = (away > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        for i in np.flatnonzero(inside):
            there = _depth_at(depth.astype(np.float64), u[i], v[i], reach[i])
            before = (there - away[i]) / reach[i] if there > 0 else 1.0
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
    """Return the depth at a place of the picture: mixed of four pixels where these are of one surface."""
    seen = float(depth[int(v), int(u)])
    height, width = depth.shape
    column = min(max(int(np.floor(u - 0.5)), 0), width - 2)
    row = min(max(int(np.floor(v - 0.5)), 0), height - 2)
    four = depth[row : row + 2, column : column + 2]
    if seen <= 0 or four.min() <= 0 or four.max() - four.min() >= reach:
        return seen
    right, down = (float(np.clip(x, 0, 1)) for x in (u - 0.5 - column, v - 0.5 - row))
    return float(np.array([1 - down, down]) @ four @ np.array([1 - right, right]))
