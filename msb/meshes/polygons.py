"""Splits polygons into triangles, and joins the faces of several parts."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A fan triangle counts as reversed if its area is negative. The magnitude, relative to the area of the
# polygon, must exceed this limit. Smaller negative areas are caused by rounding of the coordinates of convex
# polygons.
_AREA_TOLERANCE = 1e-6
# Rounding error of areas for float32 coordinates, relative to the squared size of a polygon.
_ROUNDING = 4e-7
# Limit of the work for cutting ears. The work is the sum of the squared numbers of corners of all polygons.
# The limit is `_WORK` plus `_WORK_PER_CORNER` for each polygon corner of the file. Polygons beyond the limit
# become triangle fans. With these limits, outlines of up to 2,048 corners are triangulated in a small file.
# This takes a second.
_WORK, _WORK_PER_CORNER = 1 << 22, 64
# Number of array elements (polygons x corners) that are processed at a time.
_CELLS_AT_A_TIME = 1 << 20
# A corner that is not an ear has the first score. A removed corner has the second score.
_NO_EAR, _GONE = -1.0, -2.0

Floats = NDArray[np.float64]
# The coordinates x and y of points.
Point = tuple[Floats, Floats]


@dataclass(frozen=True)
class Triangulation:
    """The triangles of polygons. The corners of all polygons are stored one after the other.

    Attributes
    ----------
    order : (F, 3) int64
        The positions of the triangle's corners among all corners. Triangles are in the order of the polygons.
    polygon : (F,) int64
        The polygon of each triangle.
    uncut : int
        The number of polygons that became overlapping fans, because they cross themselves or have too many
        corners.
    """

    order: NDArray[np.int64]
    polygon: NDArray[np.int64]
    uncut: int = 0

    @property
    def left_out(self) -> tuple[str, ...]:
        """The entries for `Mesh.left_out`, the list of ignored data."""
        if not self.uncut:
            return ()
        what = (
            "1 polygon that crosses itself"
            if self.uncut == 1
            else f"{self.uncut:,} polygons that cross themselves"
        )
        return (f"the outline of {what} or has too many corners (read as a triangle fan)",)


def triangulate(points: NDArray[Any], corners: NDArray[np.int64], counts: NDArray[np.int64]) -> Triangulation:
    """Split every polygon into triangles, without new vertices.

    The argument `points` (V, 3) contains the vertices. The argument `corners` (C,) contains the concatenated
    vertex indices of all polygons. The argument `counts` (N,) is the number of corners of each polygon. A
    polygon with n corners gives n - 2 triangles. Polygons with fewer than three corners are dropped.

    Usually a polygon becomes the triangle fan (0, 1, 2), (0, 2, 3), ... around its first corner. The fan of a
    convex polygon has no reversed triangle. If a triangle of the fan is reversed, ears are cut from the
    polygon instead. The polygon is first projected along its normal, computed by Newell's method. Polygons
    that cross themselves or have invalid vertices stay triangle fans.
    """
    order, polygon = _make_fans(counts)
    if np.all(counts <= 3):
        return Triangulation(order, polygon)
    # Find the polygons with overlapping fan triangles. Polygons with the same number of corners are examined
    # together.
    first = np.cumsum(counts) - counts
    concave, uncut = [np.zeros(0, np.int64)], 0
    by_size = np.argsort(counts, kind="stable")
    for group in np.split(by_size, np.flatnonzero(np.diff(counts[by_size])) + 1):
        size = int(counts[group[0]])
        step = max(_CELLS_AT_A_TIME // max(size, 1), 1)
        for start in range(0, len(group) if size > 3 else 0, step):
            part = group[start : start + step]
            is_turned, is_covered = _judge_fans(_gather(points, corners, first[part], counts[part], size))
            concave.append(part[is_turned & ~is_covered])
            uncut += int(np.count_nonzero(is_covered))
    # Cut the smallest polygons first, until the limit of the work is reached. The resulting ears replace the
    # fans.
    chosen = np.concatenate(concave)
    row = np.cumsum(np.maximum(counts - 2, 0)) - np.maximum(counts - 2, 0)
    uncut += len(chosen)
    for part, width in _make_batches(chosen, counts[chosen], _WORK + _WORK_PER_CORNER * len(corners)):
        outlines = _project(_gather(points, corners, first[part], counts[part], width))
        triangles, is_cut = _cut_ears(*outlines, counts[part])
        part, triangles = part[is_cut], triangles[is_cut]
        places = np.repeat(row[part], counts[part] - 2) + concatenate_ranges(counts[part] - 2)
        is_used = np.arange(width - 2) < (counts[part] - 2)[:, None]
        order[places] = (first[part][:, None, None] + triangles)[is_used]
        uncut -= len(part)
    return Triangulation(order, polygon, uncut)


def fan_triangulate(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangle fan (F, 3) of one polygon with the vertex indices `corners` (C,)."""
    return corners[_make_fans(np.array([len(corners)]))[0]]


def _make_fans(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the fans of all polygons. The result has the corner positions (F, 3) and the polygon index (F,)
    of each triangle."""
    if np.all(counts == 3):
        return np.arange(3 * len(counts)).reshape(-1, 3), np.arange(len(counts))
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    # first, second (F,): the positions of the first corner and the second corner of each triangle.
    first = (np.cumsum(counts) - counts)[polygon]
    second = first + 1 + concatenate_ranges(triangles)
    return np.stack((first, second, second + 1), axis=1), polygon


def _gather(
    points: NDArray[Any],
    corners: NDArray[np.int64],
    first: NDArray[np.int64],
    counts: NDArray[np.int64],
    width: int,
) -> Floats:
    """Return x, y and z (3, P, `width`) of polygons relative to their first corner.

    The polygons are scaled to a size of 1. The argument `first` (P,) contains the positions of the first
    corners. Shorter polygons are padded with their last corner. Invalid vertices have NaN coordinates.
    """
    rows = corners[first[:, None] + np.minimum(np.arange(width), counts[:, None] - 1)]
    wrong = (rows < 0) | (rows >= len(points))
    placed = np.zeros((3, *rows.shape))
    with np.errstate(all="ignore"):
        for axis in range(3):
            placed[axis] = points[:, axis][np.where(wrong, 0, rows)] if len(points) else np.nan
        placed[:, wrong] = np.nan
        placed -= placed[:, :, :1].copy()
        size = np.abs(placed).max(axis=(0, 2))
        placed /= np.where(size > 0, size, 1)[:, None]
    return placed


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products (3, ...) of vectors (3, ...)."""
    return np.stack([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def _judge_fans(placed: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks (P,) of polygons (3, P, n) with overlapping fan triangles.

    The first mask selects polygons whose fans have reversed triangles. Ears can be cut from polygons with
    reversed triangles. The second mask selects polygons that cross themselves.
    """
    with np.errstate(all="ignore"):
        # Compute `across` (3, P, n - 2): twice the area of each fan triangle, along its normal. The sum over
        # the triangles is the normal of the polygon by Newell's method.
        a, b = placed[..., 1:-1], placed[..., 2:]
        across = _cross(a, b)
        normal = across.sum(axis=2)
        area = np.sqrt((normal**2).sum(axis=0))
        # A triangle is reversed if its normal is opposite to the normal of the polygon.
        unit = normal / np.where(area > 0, area, 1)
        is_turned = (across * unit[..., None]).sum(axis=0).min(axis=1) < -_AREA_TOLERANCE * area - _ROUNDING
        # If the polygon has no normal, its area is zero, or its triangles cancel each other.
        length = np.sqrt((across**2).sum(axis=0))
        total = length.sum(axis=1)
        is_covered = (area < _AREA_TOLERANCE * total) & (total > _ROUNDING)
        # A fan also overlaps itself if its angles at the first corner exceed a full turn.
        if placed.shape[2] > 4:
            angle = np.arctan2(length, (a * b).sum(axis=0)).sum(axis=1)
            is_covered |= ~is_turned & (angle > 2 * np.pi + _AREA_TOLERANCE) & (total > _ROUNDING)
    return is_turned, is_covered


def _make_batches(
    concave: NDArray[np.int64], counts: NDArray[np.int64], work: int
) -> Iterator[tuple[NDArray[np.int64], int]]:
    """Yield groups of the polygons `concave` (P,), and the width of each group.

    The width is the largest number of corners of a polygon in the group. Small polygons come first. Polygons
    beyond the limit `work` are left out.
    """
    by_size = np.argsort(counts, kind="stable")
    width = 1 << np.ceil(np.log2(counts[by_size])).astype(np.int64)
    is_within = np.cumsum(width**2) <= work
    for most in np.unique(width[is_within]).tolist():
        group = concave[by_size[is_within & (width == most)]]
        step = max(_CELLS_AT_A_TIME // most, 1)
        for start in range(0, len(group), step):
            yield group[start : start + step], most


def _project(placed: Floats) -> tuple[Floats, Floats]:
    """Drop one of the three coordinates of polygons (3, P, M). Return the other two coordinates, each (P, M).

    The returned polygons are counter-clockwise. The coordinate axis with the largest component of the normal
    is dropped.
    """
    normal = _cross(placed[..., :-1], placed[..., 1:]).sum(axis=2)
    axis = np.argmax(np.abs(normal), axis=0)
    every = np.arange(len(axis))
    # axes (2, P): the two axes that follow the dropped axis in cyclic order. The two axes are swapped if the
    # normal's component along the dropped axis is negative.
    axes = np.stack(((axis + 1) % 3, (axis + 2) % 3))
    is_down = normal[axis, every] < 0
    axes[:, is_down] = axes[::-1, is_down]
    return placed[axes[0], every], placed[axes[1], every]


def _cut_ears(x: Floats, y: Floats, counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Cut counter-clockwise polygons with the coordinates (P, M) and `counts` (P,) corners into triangles.

    Return the corners (P, M - 2, 3) of the triangles. Also return a mask (P,) of the polygons that were cut.
    In each round, every polygon loses its best-shaped ear.
    """
    ring = _Ring.of(x, y, counts)
    polygons, width = x.shape
    triangles = np.zeros((polygons, width - 2, 3), np.int64)
    is_cut = ~ring.cross_themselves()
    scores = np.stack([ring.score(np.full(polygons, corner)) for corner in range(width)], axis=1)
    scores[~ring.is_left] = _GONE
    every = np.arange(polygons)
    for number in range(width - 2):
        ear = np.argmax(scores, axis=1)
        before, after = ring.before[every, ear], ring.after[every, ear]
        triangles[:, number] = np.stack((before, ear, after), axis=1)
        # The remaining corners are the last triangle. The last triangle of a polygon must not be reversed.
        left = counts - number
        is_right = ring.area(before, ear, after) >= -_ROUNDING
        is_cut &= (left < 3) | np.where(left == 3, is_right, scores[every, ear] > _NO_EAR)
        # Remove the ear, and examine its neighbouring corners again.
        ring.remove(ear, before, after)
        scores[every, ear] = _GONE
        for beside in (before, after):
            scores[every, beside] = ring.score(beside)
    return triangles, is_cut


@dataclass
class _Ring:
    """The remaining corners of polygons, as linked rings.

    The fields `x` and `y` (P, M) are the coordinates of the corners. The fields `before` and `after` (P, M)
    are the neighbours of the corners. The mask `is_left` (P, M) selects the remaining corners.
    """

    x: Floats
    y: Floats
    before: NDArray[np.int64]
    after: NDArray[np.int64]
    is_left: NDArray[np.bool_]

    @classmethod
    def of(cls, x: Floats, y: Floats, counts: NDArray[np.int64]) -> "_Ring":
        """Return the complete rings of polygons (P, M) with `counts` (P,) corners."""
        number = np.arange(x.shape[1])
        before, after = (number - 1) % counts[:, None], (number + 1) % counts[:, None]
        return cls(x, y, before, after, number < counts[:, None])

    def remove(self, corner: NDArray[np.int64], before: NDArray[np.int64], after: NDArray[np.int64]) -> None:
        """Remove one corner (P,) of each polygon. The corner lies between its neighbours `before` and `after`
        (P,)."""
        every = np.arange(len(corner))
        self.after[every, before] = after
        self.before[every, after] = before
        self.is_left[every, corner] = False

    def area(self, *corners: NDArray[np.int64]) -> Floats:
        """Return twice the signed area (P,) of a triangle of each polygon."""
        every = np.arange(len(self.x))
        return _area(*((self.x[every, corner], self.y[every, corner]) for corner in corners))

    def score(self, corner: NDArray[np.int64]) -> Floats:
        """Return a score for the triangle at one corner (P,) of each polygon, or `_NO_EAR`.

        The score is the area divided by the sum of squared side lengths. A triangle is only an ear if it
        contains no other corner of the polygon, not even on its sides. Ignore corners that coincide with a
        corner of the ear. Coinciding corners exist where a cut joins a hole to the outline. A triangle is not
        an ear if another side of the polygon leads from the tip into the triangle.
        """
        every = np.arange(len(corner))
        before, after = self.before[every, corner], self.after[every, corner]
        a, b, c = ((self.x[every, at], self.y[every, at]) for at in (before, corner, after))
        area = _area(a, b, c)
        is_ear = (area >= 0) & self.is_left[every, corner]
        # Candidates (N,) are the corners in the bounding box of a triangle, with the indices of their
        # polygons.
        is_near = self.is_left & is_ear[:, None]
        for values, axis in ((self.x, 0), (self.y, 1)):
            sides = np.stack((a[axis], b[axis], c[axis]))
            is_near &= (values >= sides.min(axis=0)[:, None]) & (values <= sides.max(axis=0)[:, None])
        polygon, number = np.nonzero(is_near)
        a, b, c = ((x[polygon], y[polygon]) for x, y in (a, b, c))
        q = self.x[polygon, number], self.y[polygon, number]
        is_inside = (_area(a, b, q) >= 0) & (_area(b, c, q) >= 0) & (_area(c, a, q) >= 0)
        at_tip, at_end = ((q[0] == p[0]) & (q[1] == p[1]) for p in (b, a))
        at_end |= (q[0] == c[0]) & (q[1] == c[1])
        # A side leads into the triangle if its direction lies between the two sides at the tip.
        leads_in = np.zeros(len(polygon), bool)
        for neighbours in (self.before, self.after):
            end = neighbours[polygon, number]
            e = self.x[polygon, end], self.y[polygon, end]
            leads_in |= (_area(a, b, e) > 0) & (_area(b, c, e) > 0)
        is_blocking = np.where(at_tip, leads_in, is_inside & ~at_end)
        is_ear[polygon[is_blocking]] = False
        squares = sum(
            (p[axis] - q[axis]) ** 2 for axis in (0, 1) for p, q in self._sides(before, corner, after)
        )
        return np.where(is_ear, area / np.where(squares > 0, squares, 1), _NO_EAR)

    def _sides(self, *corners: NDArray[np.int64]) -> list[tuple[Point, Point]]:
        """For one triangle per polygon, return both ends of each side."""
        every = np.arange(len(self.x))
        a, b, c = ((self.x[every, corner], self.y[every, corner]) for corner in corners)
        return [(a, b), (b, c), (c, a)]

    def cross_themselves(self) -> NDArray[np.bool_]:
        """Return a mask (P,) of the polygons with two crossing sides."""
        ends = [np.take_along_axis(values, self.after, axis=1) for values in (self.x, self.y)]
        low = [np.minimum(*pair) for pair in ((self.x, ends[0]), (self.y, ends[1]))]
        high = [np.maximum(*pair) for pair in ((self.x, ends[0]), (self.y, ends[1]))]
        crosses = np.zeros(len(self.x), bool)
        for side in range(self.x.shape[1]):
            # Compare the side (a, b) of each polygon with the sides (c, d). Only sides with touching bounding
            # boxes are compared.
            is_near = self.is_left & self.is_left[:, side, None]
            for axis in (0, 1):
                is_near &= low[axis] <= high[axis][:, side, None]
                is_near &= high[axis] >= low[axis][:, side, None]
            polygon, number = np.nonzero(is_near)
            a, b = (
                (self.x[polygon, side], self.y[polygon, side]),
                (ends[0][polygon, side], ends[1][polygon, side]),
            )
            c = self.x[polygon, number], self.y[polygon, number]
            d = ends[0][polygon, number], ends[1][polygon, number]
            is_split = _area(a, b, c) * _area(a, b, d) < 0
            is_split &= _area(c, d, a) * _area(c, d, b) < 0
            crosses[polygon[is_split]] = True
        return crosses


def _area(a: Point, b: Point, c: Point) -> Floats:
    """Return twice the signed area of triangles (N,): positive if they are counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def find_wrong_polygon(
    faces: NDArray[np.int64], polygon: NDArray[np.int64], vertices: int
) -> tuple[int, int] | None:
    """Return the first polygon with an invalid vertex index (outside 0..`vertices` - 1), and this index.

    Return None if all indices are valid. The arguments `faces` (F, 3) and `polygon` (F,) are the triangles
    and polygons of a `Triangulation`.
    """
    if not faces.size or (faces.min() >= 0 and faces.max() < vertices):
        return None
    wrong = (faces < 0) | (faces >= vertices)
    face = int(np.argmax(wrong.any(axis=1)))
    return int(polygon[face]), int(faces[face][wrong[face]][0])


def join_faces(parts: Iterable[NDArray[np.int64]], counts: Sequence[int]) -> NDArray[np.int64]:
    """Concatenate the faces of several parts, renumbered for the concatenated vertices.

    The argument `counts` contains the numbers of vertices of the parts. If an index of a part is invalid, the
    index is replaced by an index that is invalid in the result.
    """
    total, base, joined = sum(counts), 0, []
    for faces, count in zip(parts, counts, strict=True):
        beyond = np.where(faces < 0, faces, faces - count + total)
        joined.append(np.where((faces >= 0) & (faces < count), faces + base, beyond))
        base += count
    return np.concatenate(joined)


def concatenate_ranges(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the concatenated ranges 0, 1, ..., n - 1 for each n of `counts` (N,)."""
    total = int(counts.sum())
    return np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
