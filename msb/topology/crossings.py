"""Find all pairs of faces that cross each other. The test is exact for float64 corners.

Two faces cross if an edge of one face passes through the other face from one side to the other side. The edge
may pass through the border of the face. The test uses signs of determinants (Guigue and Devillers, "Fast and
Robust Triangle-Triangle Overlap Test Using Orientation Predicates", 2003). A determinant counts as 0 if it is
smaller than its rounding error. Faces that only touch do not cross. Adjacent faces do not cross at their
shared corner or edge. Coplanar faces do not cross, even if they overlap.
"""

from collections.abc import Iterator
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

# Error bound for a 3 x 3 determinant of differences. The bound is relative to the permanent of the matrix.
# The bound is (7 + 56 eps) eps with eps = 2^-53 (Shewchuk, "Adaptive Precision Floating-Point Arithmetic",
# 1997, for orient3d).
_ROUNDING = 7.8e-16
# Pairs of tree nodes per batch. The child nodes of a batch then fit into the processor cache, which doubles
# the speed.
_PAIRS_AT_ONCE = 1 << 14
# Shifts and masks that move each bit of a 21-bit number to every third place.
_SPREAD = tuple(
    (np.uint64(shift), np.uint64(mask))
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    )
)


@overload
def find_crossing_pairs(
    corners: NDArray[np.float64],
    places: NDArray[np.float64] | None = None,
    of: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]: ...
@overload
def find_crossing_pairs(corners: NDArray[np.float64], *, most: int) -> NDArray[np.int64] | None: ...
def find_crossing_pairs(
    corners: NDArray[np.float64],
    places: NDArray[np.float64] | None = None,
    of: NDArray[np.bool_] | None = None,
    *,
    most: int | None = None,
) -> NDArray[np.int64] | None:
    """Return the pairs (n, 2) of crossing faces in sorted order. Each pair is listed once, with the lower
    index first.

    Parameters
    ----------
    corners : (F, 3, 3) float64
        The corners of the faces, all finite.
    places : (F, n, 3) float64, optional
        Points that define the bounding boxes. By default, the bounding boxes are computed from `corners`. If
        face sizes differ by many orders of magnitude, pass points in coordinates that make the sizes similar.
    of : (F,) bool, optional
        Return only the pairs that contain at least one of these faces.
    most : int, optional
        The maximum number of pairs of overlapping bounding boxes to test. Long, thin faces have many
        overlapping boxes.

    Returns
    -------
    (n, 2) int64, or None if more than `most` pairs would have to be tested
    """
    boxes = corners if places is None else places
    crossing, tested = [np.zeros((0, 2), np.int64)], 0
    for pairs in _find_near_pairs(boxes.min(axis=1), boxes.max(axis=1), of):
        tested += len(pairs)
        if most is not None and tested > most:
            return None
        crossing.append(pairs[_test_pairs(corners[pairs[:, 0]], corners[pairs[:, 1]])])
    found = np.concatenate(crossing)
    return np.asarray(found[np.lexsort((found[:, 1], found[:, 0]))])


def _find_near_pairs(
    low: NDArray[np.float64], high: NDArray[np.float64], of: NDArray[np.bool_] | None
) -> Iterator[NDArray[np.int64]]:
    """Yield batches (n, 2) of overlapping boxes. Each pair occurs once, with the lower index first.

    The arguments `low` and `high` (F, 3) are opposite corners of the boxes. If `of` (F,) is given, at least
    one box of each pair is marked in `of`. The boxes are the leaves of a binary tree in Morton order. The
    search goes from each pair of nodes to pairs of child nodes (Karras, "Maximizing Parallelism in the
    Construction of BVHs, Octrees, and k-d Trees", 2012).
    """
    count = len(low)
    if count < 2:
        return
    # The lowest level is padded to a power of two with boxes that overlap nothing. Each level has half as
    # many nodes as the level below. A column of `boxes` contains the low corner and the negated high corner.
    depth = (count - 1).bit_length()
    order = np.argsort(_number_along_curve((low + high) / 2), kind="stable")
    boxes = [np.full((6, 1 << depth), np.inf)]
    boxes[0][:, :count] = np.concatenate([low[order].T, -high[order].T])
    wanted = [np.zeros(1 << depth, bool)]
    wanted[0][:count] = True if of is None else of[order]
    for _ in range(depth):
        boxes.append(np.minimum(boxes[-1][:, ::2], boxes[-1][:, 1::2]))
        wanted.append(wanted[-1][::2] | wanted[-1][1::2])
    # Pairs of overlapping nodes, with their level in the tree. To limit the memory, the last batch is
    # processed first.
    waiting = [(depth, np.zeros(1, np.int64), np.zeros(1, np.int64))]
    while waiting:
        level, first, second = waiting.pop()
        level -= 1
        first, second = (
            np.concatenate([2 * first + i for i in (0, 0, 1, 1)]),
            np.concatenate([2 * second + j for j in (0, 1, 0, 1)]),
        )
        # A pair of a node with itself leads to three pairs of child nodes. A pair of a leaf with itself is
        # skipped.
        keep = first <= second if level else first < second
        if of is not None:
            keep &= wanted[level][first] | wanted[level][second]
        first, second = first[keep], second[keep]
        for lows, highs in zip(boxes[level][:3], boxes[level][3:], strict=True):
            keep = (lows[first] <= -highs[second]) & (lows[second] <= -highs[first])
            first, second = first[keep], second[keep]
        if level:
            for start in range(0, len(first), _PAIRS_AT_ONCE):
                rows = slice(start, start + _PAIRS_AT_ONCE)
                waiting.append((level, first[rows], second[rows]))
        elif len(first):
            yield np.sort(order[np.stack([first, second], axis=1)], axis=1)


def _number_along_curve(points: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Return the position (n,) of each point on a Morton curve, which interleaves the bits of the
    coordinates."""
    origin = points.min(axis=0)
    extent = max(float((points.max(axis=0) - origin).max()), np.finfo(np.float64).tiny)
    numbers = np.zeros(len(points), np.uint64)
    for axis in range(3):
        # A coordinate has 21 bits. The bits are spread to every third place of the result.
        bits = np.minimum((points[:, axis] - origin[axis]) / extent * (1 << 21), (1 << 21) - 1)
        spread = bits.astype(np.uint64)
        for shift, mask in _SPREAD:
            spread = (spread | (spread << shift)) & mask
        numbers |= spread << np.uint64(axis)
    return numbers


def _test_pairs(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the crossing pairs of triangles `first` and `second` (n, 3, 3)."""
    first, second = (np.ascontiguousarray(corners.transpose(1, 2, 0)) for corners in (first, second))
    result = np.zeros(first.shape[2], bool)
    # Compute `signs_1` (3, n), the sides of the corners of `first` relative to the planes of `second`. Most
    # pairs are rejected here, because all three corners of one face are on one side of the other face.
    signs_1 = np.stack([_find_sides(second[0], second[1], second[2], first[k]) for k in range(3)])
    rows = np.flatnonzero(np.abs(signs_1.sum(axis=0)) < 3)
    first, second, signs_1 = first[..., rows], second[..., rows], signs_1[:, rows]
    signs_2 = np.stack([_find_sides(first[0], first[1], first[2], second[k]) for k in range(3)])
    # Drop a pair if all corners of `second` are on one side of `first`, or if no edge changes sides.
    apart = (np.abs(signs_2.sum(axis=0)) == 3) | (_are_on_one_side(signs_1) & _are_on_one_side(signs_2))
    rest = np.flatnonzero(~apart)
    rows, first, second = rows[rest], first[..., rest], second[..., rest]
    crossed = np.zeros(len(rows), bool)
    # An edge crosses a face if the edge fulfils two conditions. First, the ends of the edge are on different
    # sides of the face's plane. Second, the edge passes all three edges of the face with the same sense of
    # rotation.
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
    """Return the side (n,) on which each point d (3, n) lies, relative to the plane through a, b and c (3, n
    each): -1, 0 or 1.
    """
    (x, y, z), (u, v, w), (p, q, r) = (corner - d for corner in (a, b, c))
    value = x * (v * r - w * q) + y * (w * p - u * r) + z * (u * q - v * p)
    size = (
        abs(x) * (abs(v * r) + abs(w * q))
        + abs(y) * (abs(w * p) + abs(u * r))
        + abs(z) * (abs(u * q) + abs(v * p))
    )
    return np.asarray(np.sign(value) * (abs(value) > _ROUNDING * size), np.int8)
