"""Find pairs of faces that cross each other, decided exactly for float64 corners.

Two faces cross if an edge of one face passes through the other face or its border, from one side to the
other. The test uses signs of determinants (Guigue and Devillers, "Fast and Robust Triangle-Triangle Overlap
Test Using Orientation Predicates", 2003). A determinant within its rounding error counts as 0. Faces that
only touch do not cross. Neighbours do not cross at their shared corner or edge. Coplanar faces do not cross,
even if they overlap.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Error bound of a 3 x 3 determinant of differences, relative to its permanent. It is (7 + 56 eps) eps with
# eps = 2^-53 (Shewchuk, "Adaptive Precision Floating-Point Arithmetic", 1997, for orient3d).
_ROUNDING = 7.8e-16
# Candidate pairs per batch. Their arrays fit into the processor cache. Batches of millions of pairs take
# twice as long.
_PAIRS_AT_ONCE = 1 << 16
# Maximum number of grid cells per face, on average. A finer grid would put large faces into too many cells.
_CELLS_PER_FACE = 64


def find_crossing_pairs(
    corners: NDArray[np.float64],
    places: NDArray[np.float64] | None = None,
    of: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """Return the pairs (n, 2) of faces that cross, sorted, each pair once with the lower number first.

    Parameters
    ----------
    corners : (F, 3, 3) float64
        The corners of the faces, all finite.
    places : (F, n, 3) float64, optional
        Points that define the bounding boxes instead of `corners`. Pass the faces mapped to a space in which
        they have similar sizes, because the search is slow if sizes differ widely.
    of : (F,) bool, optional
        Return only pairs with at least one of these faces.
    """
    near = _find_near_pairs(corners if places is None else places, of)
    crossing = [pairs[_test_pairs(corners[pairs[:, 0]], corners[pairs[:, 1]])] for pairs in near]
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *crossing])
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _find_near_pairs(
    corners: NDArray[np.float64], of: NDArray[np.bool_] | None
) -> Iterator[NDArray[np.int64]]:
    """Yield batches (n, 2) of face pairs whose bounding boxes overlap, each pair once.

    If `of` is given, each pair has at least one of these faces.
    """
    if len(corners) < 2:
        return
    low, high = (np.ascontiguousarray(edge.T) for edge in (corners.min(axis=1), corners.max(axis=1)))
    origin = low.min(axis=1)
    extent = np.maximum((high.max(axis=1) - origin).max(), np.finfo(np.float64).tiny)
    sizes = (high - low).max(axis=0)
    # Cell size: the 75 % quantile of the face sizes, but no less than 1/1024 of the extent.
    cell = max(float(np.quantile(sizes, 0.75)), float(extent) / 1024, np.finfo(np.float64).tiny)
    while True:
        # There are at most 1025 cells along each axis, so that cell numbers fit into 32 bits.
        first, last = (np.floor((edge - origin[:, None]) / cell).astype(np.int32) for edge in (low, high))
        spans = last - first + 1
        cells = spans.prod(axis=0, dtype=np.int64)
        if int(cells.sum()) <= max(_CELLS_PER_FACE * len(corners), 1 << 20):
            break
        cell *= 2
    # One entry (face, cell) for each cell that a bounding box overlaps, sorted by cell number.
    count = last.max(axis=1) + 1
    face = np.repeat(np.arange(len(corners), dtype=np.int32), cells)
    offset = (np.arange(len(face)) - np.repeat(np.cumsum(cells) - cells, cells)).astype(np.int32)
    columns = []
    for axis in (2, 1):
        offset, column = np.divmod(offset, spans[axis][face])
        columns.append(first[axis][face] + column)
    key = _number_cells((first[0][face] + offset, *reversed(columns)), count)
    del offset, column, columns
    order = np.argsort(key, kind="stable")
    key, face = key[order], face[order]
    if of is not None:
        # Drop cells without a face of `of`.
        starts = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
        shared = np.logical_or.reduceat(of[face], starts)
        keep = np.repeat(shared, np.diff(starts, append=len(key)))
        key, face = key[keep], face[keep]
        if not len(key):
            return
    # Pair each entry with the later entries of its cell. `total` is the cumulative number of pairs. A batch
    # has about _PAIRS_AT_ONCE pairs.
    ends = np.flatnonzero(np.append(key[1:] != key[:-1], True)) + 1
    stop = np.repeat(ends, np.diff(ends, prepend=0))
    total = np.cumsum(stop - np.arange(len(face)) - 1)
    start = 0
    while start < len(face):
        done = total[start - 1] if start else 0
        end = max(start + 1, int(np.searchsorted(total, done + _PAIRS_AT_ONCE, side="right")))
        many = np.diff(total[start:end], prepend=done)
        left = np.repeat(np.arange(end - start), many)
        right = np.arange(len(left)) - np.repeat(total[start:end] - many - done, many) + left + 1
        faces = face[start : stop[end - 1]]
        if of is not None:
            keep = of[faces[left]] | of[faces[right]]
            left, right = left[keep], right[keep]
        for axis in range(3):
            lowest, highest = low[axis][faces], high[axis][faces]
            overlap = (lowest[left] <= highest[right]) & (lowest[right] <= highest[left])
            left, right = left[overlap], right[overlap]
        # Two boxes may share several cells. Keep their pair only in the lowest of these cells.
        pairs = np.stack([faces[left], faces[right]])
        shared = np.maximum(first[:, pairs[0]], first[:, pairs[1]])
        keep = key[start + left] == _number_cells(shared, count)
        yield np.sort(pairs[:, keep].T.astype(np.int64), axis=1)
        start = end


def _number_cells(cell: Sequence[NDArray[np.int32]], count: NDArray[np.int32]) -> NDArray[np.int32]:
    x, y, z = cell
    return np.asarray((x * count[1] + y) * count[2] + z)


def _test_pairs(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the pairs that cross; `first` and `second` are triangles (n, 3, 3)."""
    first, second = (np.ascontiguousarray(corners.transpose(1, 2, 0)) for corners in (first, second))
    result = np.zeros(first.shape[2], bool)
    # signs_1 (3, n): sides of the corners of `first` relative to the planes of `second`. Most pairs end here,
    # because all three corners are on one side.
    signs_1 = np.stack([_find_sides(second[0], second[1], second[2], first[k]) for k in range(3)])
    rows = np.flatnonzero(np.abs(signs_1.sum(axis=0)) < 3)
    first, second, signs_1 = first[..., rows], second[..., rows], signs_1[:, rows]
    signs_2 = np.stack([_find_sides(first[0], first[1], first[2], second[k]) for k in range(3)])
    # Remove pairs in which all corners of `second` are on one side, or in which no edge changes sides.
    apart = (np.abs(signs_2.sum(axis=0)) == 3) | (_are_on_one_side(signs_1) & _are_on_one_side(signs_2))
    rest = np.flatnonzero(~apart)
    rows, first, second = rows[rest], first[..., rest], second[..., rest]
    crossed = np.zeros(len(rows), bool)
    # An edge crosses a face if its ends are on different sides of the plane, and if it also passes all three
    # edges of the face with the same sense of rotation.
    for edges, face, signs in ((first, second, signs_1[:, rest]), (second, first, signs_2[:, rest])):
        for k in range(3):
            start, stop = edges[k], edges[(k + 1) % 3]
            through = signs[k] * signs[(k + 1) % 3] < 0
            turns = np.stack([_find_sides(start, stop, face[j], face[(j + 1) % 3]) for j in range(3)])
            crossed |= through & _are_on_one_side(turns)
    result[rows] = crossed
    return result


def _are_on_one_side(signs: NDArray[np.int8]) -> NDArray[np.bool_]:
    return np.asarray((signs >= 0).all(axis=0) | (signs <= 0).all(axis=0))


def _find_sides(a: NDArray[Any], b: NDArray[Any], c: NDArray[Any], d: NDArray[Any]) -> NDArray[np.int8]:
    """Return the side (n,) of the points d (3, n) relative to the planes a, b, c (3, n each): -1, 0 or 1."""
    (x, y, z), (u, v, w), (p, q, r) = (corner - d for corner in (a, b, c))
    value = x * (v * r - w * q) + y * (w * p - u * r) + z * (u * q - v * p)
    size = (
        abs(x) * (abs(v * r) + abs(w * q))
        + abs(y) * (abs(w * p) + abs(u * r))
        + abs(z) * (abs(u * q) + abs(v * p))
    )
    return np.asarray(np.sign(value) * (abs(value) > _ROUNDING * size), np.int8)
