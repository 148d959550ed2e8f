"""The dense parts of a set of Gaussian splats, without floaters.

Captures contain faint or stray Gaussians (floaters) everywhere between the cameras. There is no gap between
floaters and objects. Therefore opacity per volume separates floaters from objects. Distance does not separate
them.
"""

import numpy as np
from numpy.typing import NDArray

# Fraction of the opacity that is ignored at each end of an axis for measuring the range. The opacity grid is
# five times as long as the measured range, and the range lies in its middle.
_TAIL = 0.02
# Number of grid cells along the longest side of the measured range.
_CELLS = 32
# A grid cell is dense if its opacity is at least this fraction of the typical opacity. Grid cells with at
# least the typical opacity contain half of all opacity.
_DENSE = 0.02
# A dense part is a floater if its opacity is less than this fraction of the largest part's opacity.
_MIN_PART = 0.02


def find_dense(points: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return a mask (N,) of the points in the dense parts. `weight` (N,) is the opacity of each point.

    If the range of the points is empty or not finite, all points are returned. O(N) time.
    """
    points = points.astype(np.float64)
    order = [np.argsort(points[:, axis], kind="stable") for axis in range(3)]
    shares = [np.cumsum(weight[rows], dtype=np.float64) for rows in order]
    if not len(points) or not shares[0][-1] > 0:
        return np.ones(len(points), bool)
    # Compute the range of most of the opacity, and a grid around this range with one extra cell on each side.
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
    # Compute the typical opacity of a grid cell, then find the dense parts.
    falling = np.sort(mass)[::-1]
    typical = falling[np.searchsorted(np.cumsum(falling), falling.sum() / 2)]
    dense = (mass >= _DENSE * typical).reshape(shape)
    kept = _keep_large_parts(dense, mass.reshape(shape))
    result = np.zeros(len(points), bool)
    result[is_inside] = _grow(kept).reshape(-1)[index]
    return result


def _keep_large_parts(dense: NDArray[np.bool_], mass: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the dense grid cells that belong to large parts.

    Grid cells of one dense part may be separated by gaps of two cells.
    """
    from scipy.ndimage import label

    parts, count = label(_grow(dense))
    totals = np.bincount(parts[dense], mass[dense], count + 1)
    return np.asarray(dense & (totals >= _MIN_PART * totals.max())[parts])


def _grow(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the given grid cells and all their neighbours, including diagonal neighbours.

    Cells at the border of the grid must be empty.
    """
    grown = cells.copy()
    for axis in range(3):
        here = np.moveaxis(grown, axis, 0)
        before = here.copy()
        here[1:] |= before[:-1]
        here[:-1] |= before[1:]
    return grown
