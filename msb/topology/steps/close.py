"""Close small holes. A hole is a boundary loop (rim) with few edges, and its cap is much smaller than the
surrounding piece."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.analysis import Analysis
from msb.topology.halfedge import NONE, face_of, next_in_face
from msb.topology.steps.change import Change, Rims, unchanged

# Default maximum number of edges of a boundary loop that is closed.
MOST_EDGES = 8
# Default maximum ratio of the area of a cap to the area of its component. A larger cap would close the
# outline of a piece instead of a hole.
MOST_SHARE = 0.25


def close(
    points: NDArray[Any],
    faces: NDArray[Any],
    *,
    most_edges: int = MOST_EDGES,
    most_share: float = MOST_SHARE,
) -> Change:
    """Close the holes with at most `most_edges` edges. Added faces and vertices come last.

    A boundary loop of three edges gets one face. A boundary loop of four edges gets two faces that share a
    diagonal. The shorter diagonal is used, unless the diagonal is already an edge. A longer boundary loop
    gets a new vertex in its middle. A boundary loop stays open in three cases:

    - The area of the cap, relative to the area of the component, exceeds `most_share`. Such a loop is the
      outline of a piece. The cap of a flat piece has the share 1, and the cap of a hemisphere has 1/2.
    - The loop is the outline of a single triangle.
    - The loop passes through a vertex twice, changes its winding, or ends at an edge of three or more faces.

    Edges keep at most two faces, and vertices keep their number of fans. The step takes O(F log F) time.
    """
    analysis = Analysis(points, faces)
    rim = _find_rims(analysis)
    small = rim.whole & (rim.sizes <= most_edges)
    # Compare the area of each cap with the area of the component around it.
    cap = np.bincount(rim.loop, weights=_measure_wedges(points, rim), minlength=len(rim.sizes))
    parts = analysis.components
    around = np.zeros(len(rim.sizes))
    around[rim.loop] = parts.areas[parts.face_component[face_of(rim.halfedge)]]
    small &= cap <= most_share * around
    # A cap over the outline of a single triangle would only repeat the triangle.
    face = face_of(rim.halfedge)
    lowest, highest = np.full(len(small), len(faces)), np.full(len(small), -1)
    np.minimum.at(lowest, rim.loop, face)
    np.maximum.at(highest, rim.loop, face)
    small &= lowest != highest
    if not small.any():
        return unchanged(faces, len(points))
    # `first` is the boundary edge at which the cap of each loop starts.
    first = np.zeros(len(rim.sizes), np.intp)
    first[rim.loop[::-1]] = np.arange(len(rim.loop))[::-1]
    caps = [_cap_triangles(rim, first[small & (rim.sizes == 3)])]
    quads, cannot = _cap_quadrangles(analysis, rim, first[small & (rim.sizes == 4)])
    middle = small & (rim.sizes > 4)
    middle[cannot] = True
    middles, rims = _cap_with_middles(rim, middle, len(points))
    added = [np.concatenate(parts) for parts in zip(*caps, *quads, middles, strict=True)]
    new = np.concatenate([faces, added[0].astype(faces.dtype)])
    return Change(
        new,
        np.concatenate([np.arange(len(points)), np.full(rims.count, NONE)]),
        np.concatenate([np.arange(len(faces)), np.full(len(added[0]), NONE)]),
        np.zeros(len(new), bool),
        rims,
        added[1],
    )


# New faces (n, 3), and the old face (n,) beside each new face.
Cap = tuple["NDArray[Any]", "NDArray[Any]"]


@dataclass(frozen=True)
class _RimEdges:
    """The boundary half-edges, and the loops that they form.

    The first five arrays have an entry for each boundary edge. The other arrays have an entry for each loop.

    Attributes
    ----------
    halfedge, start, end : (B,) integers
        The half-edge at each boundary edge, and its two vertices.
    follows : (B,) integers
        The next boundary edge around the same fan, or NONE.
    loop : (B,) integers
        The index of the loop or chain.
    sizes : (n,) integers
        The number of edges of each loop.
    whole : (n,) bool
        Whether the loop can be closed.
    """

    halfedge: NDArray[Any]
    start: NDArray[Any]
    end: NDArray[Any]
    follows: NDArray[Any]
    loop: NDArray[Any]
    sizes: NDArray[Any]
    whole: NDArray[np.bool_]


def _find_rims(analysis: Analysis) -> _RimEdges:
    mesh, fans, boundary = analysis.mesh, analysis.fans, analysis.boundary
    halfedge = mesh.edge_halfedges[mesh.edge_offsets[boundary.edges]]
    after = next_in_face(halfedge)
    leaves, enters = fans.corner_fan[halfedge], fans.corner_fan[after]
    # `begins_at` contains the boundary edge that leaves each fan. An edge that enters a fan is followed by
    # the edge that leaves the fan.
    begins_at = np.full(len(fans.fan_vertex), NONE, np.intp)
    begins_at[leaves] = np.arange(len(halfedge))
    follows = begins_at[enters]
    loop, start = boundary.chain, mesh.origin[halfedge]
    whole = boundary.closed.copy()
    # If the winding flips along a boundary, two boundary half-edges leave one fan. Then no boundary half-edge
    # leaves another fan.
    whole[loop[(np.bincount(leaves, minlength=len(begins_at))[leaves] > 1) | (follows == NONE)]] = False
    # A loop that passes through a vertex twice cannot be closed.
    order = np.lexsort((start, loop))
    twice = (loop[order][1:] == loop[order][:-1]) & (start[order][1:] == start[order][:-1])
    whole[loop[order][1:][twice]] = False
    sizes = np.bincount(loop, minlength=len(whole))
    return _RimEdges(halfedge, start, mesh.origin[after], follows, loop, sizes, whole)


def _measure_wedges(points: NDArray[Any], rim: _RimEdges) -> NDArray[np.float64]:
    """Return the area (B,) of a triangle for each boundary edge. The triangle connects the edge with the mean
    position of the loop."""
    places = points[rim.start].astype(np.float64)
    middle = np.stack([np.bincount(rim.loop, axis, len(rim.sizes)) for axis in places.T], axis=1)
    middle = middle / np.maximum(rim.sizes, 1)[:, None]
    to_start, to_end = places - middle[rim.loop], points[rim.end].astype(np.float64) - middle[rim.loop]
    return np.asarray(np.linalg.norm(np.cross(to_start, to_end), axis=1) / 2)


def _cap_triangles(rim: _RimEdges, first: NDArray[Any]) -> Cap:
    a, b, c = (rim.start[place] for place in _walk_around(rim, first, 3))
    return np.stack([a, c, b], axis=1), face_of(rim.halfedge[first])


def _cap_quadrangles(
    analysis: Analysis, rim: _RimEdges, first: NDArray[Any]
) -> tuple[list[Cap], NDArray[Any]]:
    """Return caps that consist of two faces. Also return the loops that cannot be closed, because both
    diagonals are already edges."""
    count = len(analysis.vertices)
    # `corner` (n, 4) contains the vertices of each loop in order. `beside` (n, 4) contains the old face next
    # to each boundary edge.
    places = _walk_around(rim, first, 4)
    corner = np.stack([rim.start[place] for place in places], axis=1)
    beside = np.stack([face_of(rim.halfedge[place]) for place in places], axis=1)
    where = analysis.vertices[corner].astype(np.float64)
    length = np.linalg.norm(where[:, :2] - where[:, 2:], axis=2)
    # Try the shorter diagonal first, then the longer diagonal. A diagonal that is already an edge cannot be
    # used.
    taken = analysis.mesh.edge_vertices.astype(np.int64)
    taken = taken[:, 0] * count + taken[:, 1]
    caps: list[Cap] = []
    left = np.arange(len(first))
    for longer in (False, True):
        turn = (length[left, 1] < length[left, 0]) ^ longer
        ring, face = (
            np.where(turn[:, None], np.roll(rows[left], -1, axis=1), rows[left]) for rows in (corner, beside)
        )
        diagonal = np.sort(ring[:, ::2].astype(np.int64), axis=1)
        key = diagonal[:, 0] * count + diagonal[:, 1]
        _, earliest = np.unique(key, return_index=True)  # Two holes may have the same diagonal.
        free = np.zeros(len(left), bool)
        free[earliest] = True
        free &= ~np.isin(key, taken)
        a, b, c, d = ring[free].T
        caps += [
            (np.stack([a, c, b], axis=1), face[free, 0]),
            (np.stack([a, d, c], axis=1), face[free, 2]),
        ]
        taken = np.concatenate([taken, key[free]])
        left = left[~free]
    return caps, rim.loop[first[left]]


def _cap_with_middles(rim: _RimEdges, wanted: NDArray[np.bool_], vertex_count: int) -> tuple[Cap, Rims]:
    """Close loops with a new vertex in the middle. Return the new faces, and the rims of the new vertices.

    The argument `wanted` (n,) marks the loops to close. New vertices are numbered from `vertex_count` on.
    """
    inside = np.flatnonzero(wanted[rim.loop])
    inside = inside[np.argsort(rim.loop[inside], kind="stable")]
    number = np.cumsum(wanted) - 1
    middle = vertex_count + number[rim.loop[inside]]
    cap = np.stack([rim.end[inside], rim.start[inside], middle], axis=1)
    offsets = np.concatenate([[0], np.cumsum(rim.sizes[wanted])])
    return (cap, face_of(rim.halfedge[inside])), Rims(offsets, rim.start[inside])


def _walk_around(rim: _RimEdges, first: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """Return `count` arrays (n,). The first array is `first`. Each further array contains the boundary edges
    that follow the previous array."""
    places = [first]
    for _ in range(count - 1):
        places.append(rim.follows[places[-1]])
    return places
