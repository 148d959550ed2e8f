"""The dense part of Gaussian splats, without the floaters around it.

Captures leave faint or stray Gaussians everywhere between the cameras. They have no gap to the object, so
distances do not separate them; the opacity per volume does.
"""

import numpy as np
from numpy.typing import NDArray

# Quantile on each side of the opacity along an axis. The grid covers twice the range between them on each
# side.
_TAIL = 0.02
# Cells along the longest side of that range.
_CELLS = 32
# A cell is dense if its opacity is at least this share of the opacity of a typical dense cell: half of all
# opacity is in cells that have at least as much as the typical one.
_DENSE = 0.02
# Dense parts with less than this share of the opacity of the largest one are floaters.
_MIN_PART = 0.02


def find_dense(points: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return a mask (N,) of the points in the dense parts; `weight` (N,) is their opacity.

    All points are returned if their range is empty or not finite. O(N) time.
    """
    points = points.astype(np.float64)
    order = [np.argsort(points[:, axis], kind="stable") for axis in range(3)]
    shares = [np.cumsum(weight[rows], dtype=np.float64) for rows in order]
    if not len(points) or not shares[0][-1] > 0:
        return np.ones(len(points), bool)
    # The range of most of the opacity, and a grid around it with one more cell on each side.
    low, high = (
        np.array(
            [
                points[rows[np.searchsorted(share, tail * share[-1])], axis]
                for axis, (rows, share) in enumerate(zip(order, shares, strict=True))
            ]
        )
        for tail in (_TAIL, 1 - _TAIL)
    )
    cell = float((high - low).max() / _CELLS)
    if not cell > 0:
        return np.ones(len(points), bool)
    low, high = low - (high - low), high + (high - low)
    shape = tuple(int(n) + 3 for n in np.ceil((high - low) / cell))
    place = np.floor((points - low) / cell) + 1
    is_inside = ((place >= 1) & (place < np.array(shape) - 1)).all(axis=1)
    index = np.ravel_multi_index(tuple(place[is_inside].astype(np.int64).T), shape)
    mass = np.bincount(index, weight[is_inside], int(np.prod(shape))).astype(np.float64)
    # The typical dense cell, and the dense parts.
    falling = np.sort(mass)[::-1]
    typical = falling[np.searchsorted(np.cumsum(falling), falling.sum() / 2)]
    dense = (mass >= _DENSE * typical).reshape(shape)
    kept = _keep_large_parts(dense, mass.reshape(shape))
    result = np.zeros(len(points), bool)
    result[is_inside] = _grow(kept).reshape(-1)[index]
    return result


def _keep_large_parts(dense: NDArray[np.bool_], mass: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the dense cells that belong to parts with enough opacity. Parts may have gaps of two cells."""
    from scipy.ndimage import label

    parts, count = label(_grow(dense))
    totals = np.bincount(parts[dense], mass[dense], count + 1)
    return np.asarray(dense & (totals >= _MIN_PART * totals.max())[parts])


def _grow(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells and their neighbours along each axis and diagonal. Border cells must be empty."""
    grown = cells.copy()
    for axis in range(3):
        here = np.moveaxis(grown, axis, 0)
        before = here.copy()
        here[1:] |= before[:-1]
        here[:-1] |= before[1:]
    return grown
