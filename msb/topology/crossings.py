"""Faces that cross each other, exactly decided on float64 corners.

Two faces cross if an edge of one goes from side to side of the other through it, its border included. The
signs of determinants decide that (as in Guigue and Devillers, "Fast and Robust Triangle-Triangle Overlap Test
Using Orientation Predicates", 2003), and one that is within its rounding error counts as 0. So faces that
only touch do not cross, neither do neighbours at their common corner or edge, nor faces that overlap flat.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Bound of the error of a 3 x 3 determinant of differences, relative to its permanent: (7 + 56 eps) eps with
# eps = 2^-53 (Shewchuk, "Adaptive Precision Floating-Point Arithmetic", 1997, for orient3d).
_ROUNDING = 7.8e-16
# Candidate pairs tested at once; their arrays fit the processor's cache, twice as fast as millions.
_PAIRS_AT_ONCE = 1 << 16
# Most grid cells per face, on average; a finer grid would put large faces into too many cells.
_CELLS_OF_A_FACE = 64


def crossing_pairs(
    corners: NDArray[np.float64],
    places: NDArray[np.float64] | None = None,
    of: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """Return the pairs (n, 2) of faces that cross, each once with the lower number first, sorted.

    `corners` (F, 3, 3) are finite. Only faces are compared whose boxes overlap: those of `places` (F, n, 3)
    if given, where faces lie in a space in which they are of similar size. Each pair has one `of` these faces
    (F,).
    """
    near = _near(corners if places is None else places, of)
    crossing = [pairs[_cross(corners[pairs[:, 0]], corners[pairs[:, 1]])] for pairs in near]
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *crossing])
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _near(corners: NDArray[np.float64], of: NDArray[np.bool_] | None) -> Iterator[NDArray[np.int64]]:
    """Yield the pairs of faces, one `of` some, whose bounding boxes overlap, each once, some at a time."""
    if len(corners) < 2:
        return
    low, high = (np.ascontiguousarray(edge.T) for edge in (corners.min(axis=1), corners.max(axis=1)))
    origin = low.min(axis=1)
    extent = np.maximum((high.max(axis=1) - origin).max(), np.finfo(np.float64).tiny)
    sizes = (high - low).max(axis=0)
    # Cells of the usual face's size, and not so small that large faces fill the memory.
    cell = max(float(np.quantile(sizes, 0.75)), float(extent) / 1024, np.finfo(np.float64).tiny)
    while True:
        # At most 1025 cells along each axis, so that numbers of cells fit 32 bits.
        first, last = (np.floor((edge - origin[:, None]) / cell).astype(np.int32) for edge in (low, high))
        spans = last - first + 1
        cells_of = spans.prod(axis=0, dtype=np.int64)
        if int(cells_of.sum()) <= max(_CELLS_OF_A_FACE * len(corners), 1 << 20):
            break
        cell *= 2
    count = last.max(axis=1) + 1
    face = np.repeat(np.arange(len(corners), dtype=np.int32), cells_of)
    turn = (np.arange(len(face)) - np.repeat(np.cumsum(cells_of) - cells_of, cells_of)).astype(np.int32)
    steps = []
    for axis in (2, 1):
        turn, step = np.divmod(turn, spans[axis][face])
        steps.append(first[axis][face] + step)
    key = _cell_number((first[0][face] + turn, *reversed(steps)), count)
    del turn, step, steps
    order = np.argsort(key, kind="stable")
    key, face = key[order], face[order]
    if of is not None:
        starts = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
        shared = np.logical_or.reduceat(of[face], starts)
        kept = np.repeat(shared, np.diff(starts, append=len(key)))
        key, face = key[kept], face[kept]
        if not len(key):
            return
    # Each entry is paired with those after it in its cell.
    ends = np.flatnonzero(np.append(key[1:] != key[:-1], True)) + 1
    stop = np.repeat(ends, np.diff(ends, prepend=0))
    total = np.cumsum(stop - np.arange(len(face)) - 1)
    start = 0
    while start < len(face):
        done = total[start - 1] if start else 0
        end = max(start + 1, int(np.searchsorted(total, done + _PAIRS_AT_ONCE, side="right")))
        partners = np.diff(total[start:end], prepend=done)
        one = np.repeat(np.arange(end - start), partners)
        two = np.arange(len(one)) - np.repeat(total[start:end] - partners - done, partners) + one + 1
        faces = face[start : stop[end - 1]]
        if of is not None:
            kept = of[faces[one]] | of[faces[two]]
            one, two = one[kept], two[kept]
        for axis in range(3):
            lowest, highest = low[axis][faces], high[axis][faces]
            overlap = (lowest[one] <= highest[two]) & (lowest[two] <= highest[one])
            one, two = one[overlap], two[overlap]
        # Both boxes reach into several cells: the pair counts in the lowest of those they share.
        pairs = np.stack([faces[one], faces[two]])
        shared = np.maximum(first[:, pairs[0]], first[:, pairs[1]])
        kept = key[start + one] == _cell_number(shared, count)
        yield np.sort(pairs[:, kept].T.astype(np.int64), axis=1)
        start = end


def _cell_number(cell: Sequence[NDArray[np.int32]], count: NDArray[np.int32]) -> NDArray[np.int32]:
    x, y, z = cell
    return np.asarray((x * count[1] + y) * count[2] + z)


def _cross(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which pairs of triangles (n, 3, 3) cross."""
    one, two = (np.ascontiguousarray(each.transpose(1, 2, 0)) for each in (one, two))
    result = np.zeros(one.shape[2], bool)
    # Most are wholly on one side of the other's plane.
    sides_of_two = np.stack([_orient(two[0], two[1], two[2], one[k]) for k in range(3)])
    rows = np.flatnonzero(np.abs(sides_of_two.sum(axis=0)) < 3)
    one, two, sides_of_two = one[..., rows], two[..., rows], sides_of_two[:, rows]
    sides_of_one = np.stack([_orient(one[0], one[1], one[2], two[k]) for k in range(3)])
    # As these are, or neither has an edge that goes from side to side.
    apart = (np.abs(sides_of_one.sum(axis=0)) == 3) | (_one_sided(sides_of_two) & _one_sided(sides_of_one))
    left = np.flatnonzero(~apart)
    rows, one, two = rows[left], one[..., left], two[..., left]
    crossed = np.zeros(len(rows), bool)
    for edges, face, sides in ((one, two, sides_of_two[:, left]), (two, one, sides_of_one[:, left])):
        for k in range(3):
            start, stop = edges[k], edges[(k + 1) % 3]
            through = sides[k] * sides[(k + 1) % 3] < 0
            turns = np.stack([_orient(start, stop, face[j], face[(j + 1) % 3]) for j in range(3)])
            crossed |= through & _one_sided(turns)
    result[rows] = crossed
    return result


def _one_sided(signs: NDArray[np.int8]) -> NDArray[np.bool_]:
    return np.asarray((signs >= 0).all(axis=0) | (signs <= 0).all(axis=0))


def _orient(a: NDArray[Any], b: NDArray[Any], c: NDArray[Any], d: NDArray[Any]) -> NDArray[np.int8]:
    """Return on which side of the planes through a, b, c the points d lie: -1, 0 or 1; (3, n) -> (n,)."""
    (x, y, z), (u, v, w), (p, q, r) = (each - d for each in (a, b, c))
    value = x * (v * r - w * q) + y * (w * p - u * r) + z * (u * q - v * p)
    size = (
        abs(x) * (abs(v * r) + abs(w * q))
        + abs(y) * (abs(w * p) + abs(u * r))
        + abs(z) * (abs(u * q) + abs(v * p))
    )
    return np.asarray(np.sign(value) * (abs(value) > _ROUNDING * size), np.int8)
