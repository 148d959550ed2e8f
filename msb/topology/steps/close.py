"""Close small holes: rims of few edges whose cap is small beside the piece it is in."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.analysis import Analysis
from msb.topology.halfedge import NONE, face_of, next_in_face
from msb.topology.steps.change import Change, Rims, unchanged

# Rims of more edges stay open, if nothing else is said.
MOST_EDGES = 8
# A cap of more than this share of its component's area would close an outline rather than a hole.
MOST_SHARE = 0.25


def close(
    points: NDArray[Any],
    faces: NDArray[Any],
    *,
    most_edges: int = MOST_EDGES,
    most_share: float = MOST_SHARE,
) -> Change:
    """Close the holes of at most `most_edges` edges; added faces and vertices come last.

    A rim of three edges gets a face, one of four gets two faces along its shorter diagonal that is no edge
    yet, and a longer one a vertex in its middle. Rims whose cap has a larger share than `most_share` of the
    area of their component stay open: they are the outline of a piece (the cap of a lone triangle has the
    share 1, that of a hemisphere 1/2). So do rims that meet themselves in a vertex, along which the winding
    flips, or which end at an edge of more than two faces. Edges keep at most two faces, and vertices their
    number of fans. O(F log F) time.
    """
    analysis = Analysis(points, faces)
    rim = _find_rims(analysis)
    small = rim.whole & (rim.sizes <= most_edges)
    cap = np.bincount(rim.loop, weights=_wedges(points, rim), minlength=len(rim.sizes))
    parts = analysis.components
    around = np.zeros(len(rim.sizes))
    around[rim.loop] = parts.areas[parts.face_component[face_of(rim.halfedge)]]
    small &= cap <= most_share * around
    if not small.any():
        return unchanged(faces, len(points))
    first = np.zeros(len(rim.sizes), np.intp)
    first[rim.loop[::-1]] = np.arange(len(rim.loop))[::-1]
    caps = [_triangles(rim, first[small & (rim.sizes == 3)])]
    quads, cannot = _quadrangles(analysis, rim, first[small & (rim.sizes == 4)])
    middle = small & (rim.sizes > 4)
    middle[cannot] = True
    middles, rims = _middles(rim, middle, len(points))
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


# New faces (n, 3), and the old face beside each.
Cap = tuple["NDArray[Any]", "NDArray[Any]"]


@dataclass(frozen=True)
class _RimEdges:
    """Boundary half-edges with what follows them.

    `start` and `end` are their vertices, `follows` is the place of the next one around the same fan, `loop`
    the number of the loop or chain. `sizes` and `whole` are of loops: the number of edges, and whether they
    can be closed.
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
    begins_at = np.full(len(fans.fan_vertex), NONE, np.intp)
    begins_at[leaves] = np.arange(len(halfedge))
    follows = begins_at[enters]
    loop, start = boundary.chain, mesh.origin[halfedge]
    whole = boundary.closed.copy()
    # Where winding flips along a rim, two half-edges leave one fan, and none leaves another.
    whole[loop[(np.bincount(leaves, minlength=len(begins_at))[leaves] > 1) | (follows == NONE)]] = False
    order = np.lexsort((start, loop))
    twice = (loop[order][1:] == loop[order][:-1]) & (start[order][1:] == start[order][:-1])
    whole[loop[order][1:][twice]] = False
    sizes = np.bincount(loop, minlength=len(whole))
    return _RimEdges(halfedge, start, mesh.origin[after], follows, loop, sizes, whole)


def _wedges(points: NDArray[Any], rim: _RimEdges) -> NDArray[np.float64]:
    """Return the area between each rim edge and the middle of its rim."""
    places = points[rim.start].astype(np.float64)
    middle = np.stack([np.bincount(rim.loop, axis, len(rim.sizes)) for axis in places.T], axis=1)
    middle = middle / np.maximum(rim.sizes, 1)[:, None]
    one, other = places - middle[rim.loop], points[rim.end].astype(np.float64) - middle[rim.loop]
    return np.asarray(np.linalg.norm(np.cross(one, other), axis=1) / 2)


def _triangles(rim: _RimEdges, first: NDArray[Any]) -> Cap:
    a, b, c = (rim.start[place] for place in _around(rim, first, 3))
    return np.stack([a, c, b], axis=1), face_of(rim.halfedge[first])


def _quadrangles(analysis: Analysis, rim: _RimEdges, first: NDArray[Any]) -> tuple[list[Cap], NDArray[Any]]:
    """Return the caps of two faces, and the loops whose diagonals both are edges already."""
    count = len(analysis.vertices)
    places = _around(rim, first, 4)
    corner = np.stack([rim.start[place] for place in places], axis=1)
    beside = np.stack([face_of(rim.halfedge[place]) for place in places], axis=1)
    where = analysis.vertices[corner].astype(np.float64)
    length = np.linalg.norm(where[:, :2] - where[:, 2:], axis=2)
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
        _, earliest = np.unique(key, return_index=True)  # two holes may have one diagonal
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


def _middles(rim: _RimEdges, wanted: NDArray[np.bool_], vertex_count: int) -> tuple[Cap, Rims]:
    """Return the faces between each rim edge and a new vertex, and the rims of these vertices."""
    inside = np.flatnonzero(wanted[rim.loop])
    inside = inside[np.argsort(rim.loop[inside], kind="stable")]
    number = np.cumsum(wanted) - 1
    middle = vertex_count + number[rim.loop[inside]]
    cap = np.stack([rim.end[inside], rim.start[inside], middle], axis=1)
    offsets = np.concatenate([[0], np.cumsum(rim.sizes[wanted])])
    return (cap, face_of(rim.halfedge[inside])), Rims(offsets, rim.start[inside])


def _around(rim: _RimEdges, first: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """Return `first` and the places that follow it."""
    places = [first]
    for _ in range(count - 1):
        places.append(rim.follows[places[-1]])
    return places
