"""Merges small texture charts into their neighbours, face by face.

xatlas leaves many charts of a few faces. Small charts cannot be painted by hand, and each chart wastes texels
on its margin. A face of a small chart is unfolded into the plane of a neighbouring chart, about their shared
edge. The face keeps its size, or becomes flatter if the space is too small. The unfolded face must not
overlap the chart.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from itertools import product

import numpy as np

from msb.bake.arrays import Floats, Ints
from msb.topology.faces import face_vectors

# Charts with fewer faces than this are merged into larger charts.
MIN_CHART_FACES = 50
# A chart may already contain the vertex of an unfolded corner, at a slightly different place. The corner
# moves to this place if the distance, relative to the length of the shared edge, is below this limit. If the
# distance is larger, the edge of the face becomes a texture seam.
_SNAP = 0.3
# Heights to try for an unfolded face above the shared edge, relative to the true height of the face. A spike
# of the surface makes a narrow gap in the chart. The smallest heights let a face fit into such a gap.
_HEIGHTS = (1.0, 0.8, 0.6, 0.3, 0.1)
# For overlap tests, each face is scaled about its centre by this factor. Two faces with a shared edge then do
# not overlap.
_SHRINK = 0.97
# Limits of the area of a face in the plane, divided by its area on the surface. The ratio is relative to the
# average of all charts.
_STRETCH = 0.05, 2.0


def merge_small_charts(points: Floats, faces: Ints, plane: Floats, chart: Ints) -> tuple[Floats, Ints]:
    """Return the place (F, 3, 2) of each corner in its chart, and the chart (F,) of each face.

    Parameters
    ----------
    points : (V, 3) float64
        The vertices of the mesh.
    faces : (F, 3) int64
        The faces of the mesh, with shared vertices.
    plane : (F, 3, 2) float64
        The places of the corners in the plane of their chart. All charts have about the same scale.
    chart : (F,) int64
        The chart of each face.
    """
    area = np.linalg.norm(face_vectors(points, faces), axis=1)
    scale = np.sqrt(np.abs(_signed_areas(plane)).sum() / max(area.sum(), 1e-300))
    merging = _Merging(scale * points, faces, plane.copy(), chart.copy(), scale**2 * area)
    merging.run(np.bincount(chart)[chart] < MIN_CHART_FACES)
    merging.pair_lone_faces()
    return merging.plane, merging.chart


class _Merging:
    """The state of a merge: places, charts, and the placed faces in the grid cells of their chart."""

    def __init__(self, points: Floats, faces: Ints, plane: Floats, chart: Ints, area: Floats) -> None:
        self.plane, self.chart = plane, chart
        self._points, self._faces, self._area = points, faces, area
        # The orientation of a face in its chart is stored, because xatlas may mirror a whole chart.
        self._sign = np.sign(_signed_areas(plane))
        sides = np.linalg.norm(plane - np.roll(plane, 1, axis=1), axis=2)
        self._cell = float(max(np.median(sides), 1e-12)) * 2
        self._cells: defaultdict[tuple[int, int, int], list[int]] = defaultdict(list)
        self._edges: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        for number, face in enumerate(faces.tolist()):
            for a, b in zip(face, (*face[1:], face[0]), strict=True):
                self._edges[min(a, b), max(a, b)].append(number)

    def run(self, is_free: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> None:
        """Move the free faces (F,) into the charts of other faces, the longest shared edges first."""
        if is_free.all() and len(is_free):
            is_free = self.chart != np.bincount(self.chart).argmax()
        free = set(np.flatnonzero(is_free).tolist())
        self._grow(np.flatnonzero(~is_free).tolist(), free)
        # Then merge the remaining faces with each other, beginning with the neighbours of the largest
        # remaining chart.
        while free:
            rest = sorted(free)
            largest = np.bincount(self.chart[rest]).argmax()
            hosts = [face for face in rest if self.chart[face] == largest]
            free.difference_update(hosts)
            self._grow(hosts, free)

    def pair_lone_faces(self) -> None:
        """Number the charts by their connected parts, and let each lone face take over a neighbour.

        No part of the rest of the neighbour's chart becomes a lone face.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        def label(pairs: Ints, count: int) -> Ints:
            ones = np.ones(len(pairs), np.int8)
            return np.asarray(connected_components(coo_array((ones, tuple(pairs.T)), (count, count)))[1], int)

        pairs = np.array([pair for edge in self._edges if (pair := self._find_joined(*edge))], np.int64)
        pairs = pairs.reshape(-1, 2)
        self.chart[:] = label(pairs, len(self._faces))
        self._cells.clear()
        for lone in np.flatnonzero(np.bincount(self.chart)[self.chart] == 1).tolist():
            if (self.chart == self.chart[lone]).sum() > 1:  # it was taken over by another lone face
                continue
            # Lay the face out in its true size, because xatlas enlarges slivers.
            a, b, c = self._points[self._faces[lone]]
            length = np.linalg.norm(b - a)
            x = (c - a) @ (b - a) / max(length, 1e-300)
            y = np.sqrt(max((c - a) @ (c - a) - x * x, 0))
            self.plane[lone], self._sign[lone] = [(0, 0), (length, 0), (x, y)], 1
            self._register(lone)
            edges = self._list_edges(lone)
            for face in sorted({face for edge in edges for face in self._edges[edge]} - {lone}):
                # The rest of the chart of the neighbour, and the connections within the rest.
                rest = np.flatnonzero(self.chart == self.chart[face])
                rest = rest[rest != face]
                inside = pairs[np.isin(pairs, rest).all(axis=1)]
                sizes = np.bincount(label(np.searchsorted(rest, inside), len(rest)), minlength=1)
                if (not len(rest) or sizes.min() > 1) and self._unfold(face, lone):
                    break

    def _find_joined(self, a: int, b: int) -> tuple[int, int] | None:
        """Return the two faces at the edge from vertex a to b, if they share it in the plane of a chart."""
        faces = self._edges[a, b]
        if len(faces) != 2 or self.chart[faces[0]] != self.chart[faces[1]]:
            return None
        first, second = (
            self.plane[face, [self._faces[face].tolist().index(vertex) for vertex in (a, b)]]
            for face in faces
        )
        return (faces[0], faces[1]) if (first == second).all() else None

    def _grow(self, hosts: list[int], free: set[int]) -> None:
        """Move free faces into the charts of the placed faces `hosts`. Moved faces are no longer free."""
        for face in hosts:
            self._register(face)
        queue: list[tuple[float, int, int]] = []
        for face in hosts:
            self._push_neighbours(face, free, queue)
        while queue:
            _, face, host = heapq.heappop(queue)
            if face in free and self._unfold(face, host):
                free.remove(face)
                self._register(face)
                self._push_neighbours(face, free, queue)

    def _push_neighbours(self, host: int, free: set[int], queue: list[tuple[float, int, int]]) -> None:
        for a, b in self._list_edges(host):
            length = float(np.linalg.norm(self._points[a] - self._points[b]))
            for face in self._edges[a, b]:
                if face in free:
                    heapq.heappush(queue, (-length, face, host))

    def _list_edges(self, face: int) -> list[tuple[int, int]]:
        a, b, c = self._faces[face].tolist()
        return [(min(pair), max(pair)) for pair in ((a, b), (b, c), (c, a))]

    def _unfold(self, face: int, host: int) -> bool:
        """Place a face next to `host`, about their common edge. Return whether the face fits."""
        ours, theirs = self._faces[face].tolist(), self._faces[host].tolist()
        edge = [vertex for vertex in ours if vertex in theirs]
        if len(edge) != 2:
            return False
        a, b = edge
        c = next(vertex for vertex in ours if vertex not in edge)
        at = {vertex: self.plane[host, theirs.index(vertex)] for vertex in edge}
        along, away = at[b] - at[a], self._points[c] - self._points[a]
        side = self._points[b] - self._points[a]
        square = float(side @ side)
        if square == 0:
            return False
        # Compute the coordinates of corner c relative to the shared edge. The x axis lies along the edge, and
        # the y axis points away from `host`.
        x = float(away @ side) / square
        y = float(np.sqrt(max(away @ away / square - x * x, 0)))
        across = np.array([-along[1], along[0]])
        third = self.plane[host, next(k for k in range(3) if theirs[k] not in edge)]
        if float((third - at[a]) @ across) > 0:
            across = -across
        place = at[a] + x * along + y * across
        placed = np.stack([{a: at[a], b: at[b], c: place}[vertex] for vertex in ours])
        snapped = self._snap(c, place, float(np.linalg.norm(along)), int(self.chart[host]), face)
        foot = at[a] + min(max(x, 0.0), 1.0) * along
        flatter = [foot + height * (place - foot) for height in _HEIGHTS]
        for corner in (snapped, *flatter, self._snap(c, place, np.inf, int(self.chart[host]), face)):
            if corner is None:
                continue
            placed[ours.index(c)] = corner
            if self._fits(face, placed, host):
                self.plane[face], self.chart[face] = placed, self.chart[host]
                self._sign[face] = self._sign[host]
                return True
        return False

    def _snap(self, vertex: int, place: Floats, length: float, chart: int, face: int) -> Floats | None:
        """A vertex may have several places in the chart around a face. Return the place that is nearest to
        `place`, if it is near enough."""
        best, least = None, _SNAP * length
        for edge in self._list_edges(face):
            if vertex not in edge:
                continue
            for other in self._edges[edge]:
                if other != face and self.chart[other] == chart:
                    there = self.plane[other, self._faces[other].tolist().index(vertex)]
                    distance = float(np.linalg.norm(there - place))
                    if distance < least:
                        best, least = there, distance
        return best

    def _fits(self, face: int, placed: Floats, host: int) -> bool:
        """Return whether a placed face keeps its size and orientation and overlaps no face of the chart."""
        signed = float(_signed_areas(placed[None])[0])
        area = float(self._area[face])
        if signed * self._sign[host] <= 0 and area > 0:
            return False
        if not _STRETCH[0] * area <= abs(signed) <= _STRETCH[1] * area:
            return False
        chart = int(self.chart[host])
        near = {other for cell in self._list_cells(placed) for other in self._cells.get((chart, *cell), ())}
        if not near:
            return True
        return not _overlaps(placed, self.plane[sorted(near)]).any()

    def _register(self, face: int) -> None:
        for cell in self._list_cells(self.plane[face]):
            self._cells[(int(self.chart[face]), *cell)].append(face)

    def _list_cells(self, placed: Floats) -> list[tuple[int, int]]:
        low, high = (np.floor(f(axis=0) / self._cell).astype(int).tolist() for f in (placed.min, placed.max))
        return list(product(range(low[0], high[0] + 1), range(low[1], high[1] + 1)))


def _signed_areas(corners: Floats) -> Floats:
    """Return twice the signed areas (F,) of flat triangles (F, 3, 2)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas: Floats = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return areas


def _overlaps(corners: Floats, others: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which triangles (n, 3, 2) overlap a triangle (3, 2), all slightly shrunk (`_SHRINK`)."""
    ours = corners.mean(axis=0) + _SHRINK * (corners - corners.mean(axis=0))
    middle = others.mean(axis=1, keepdims=True)
    theirs = middle + _SHRINK * (others - middle)
    apart = np.zeros(len(others), bool)
    # Two triangles are disjoint if the direction across one of their sides separates them.
    for sides in (
        np.broadcast_to(np.roll(ours, -1, axis=0) - ours, theirs.shape),
        np.roll(theirs, -1, axis=1) - theirs,
    ):
        for k in range(3):
            across = np.stack([-sides[:, k, 1], sides[:, k, 0]], axis=1)
            first = across @ ours.T
            second = np.einsum("nk,nck->nc", across, theirs)
            apart |= (first.max(axis=1) <= second.min(axis=1)) | (second.max(axis=1) <= first.min(axis=1))
    return ~apart
