"""Cut what is one-sided, like a Moebius strip, along short loops of edges until it has two sides.

Walking along edges carries a sense of rotation from vertex to vertex. A loop that comes back with the other
one is one-sided, and a surface cut along it is one-sided at fewer places. A hole of a surface counts as a
vertex beside all of its rim, so that a cut from rim to rim is a loop, too: a strip is cut across and not
lengthwise. The edges across which the windings of two faces disagree, whichever faces are turned, meet every
such loop, so the shortest begins at one of their ends.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import corners_at_ends
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of, next_in_face
from msb.topology.steps.change import Change, followed_by, unchanged
from msb.topology.steps.cut import split_vertices
from msb.topology.steps.sides import Sides, find_sides, sides_of_faces

_VISITS = 10**7
"""The most nodes that are visited for one loop: of a large component not every start is tried."""
_RIM = 1e-6
"""What a step to a rim counts, beside one along an edge."""


def cut_one_sided(
    faces: NDArray[Any], vertex_count: int, *, only_manifold: bool = False
) -> tuple[Change, int, int]:
    """Return the change that leaves no one-sided component, how many cuts that takes, and of how many edges.

    Components are joined across edges of two faces. Vertices along a cut get copies at the end; faces keep
    their places. A mesh without one-sided components is not changed, nor with `only_manifold` one with edges
    of more than two faces: a cut parts all of these.
    """
    change, cuts, edges = unchanged(faces, vertex_count), 0, 0
    while True:
        mesh = build_half_edges(change.faces, len(change.vertex_map))
        sides = sides_of_faces(mesh)
        if not sides.one_sided.any() or (only_manifold and (mesh.multiplicity > 2).any()):
            return change, cuts, edges
        one, other = mesh.two_face_halfedges
        loops = _shortest_loops(mesh, one, other, sides)
        keep = np.ones(len(one), bool)
        keep[np.concatenate(loops)] = False
        cuts, edges = cuts + len(loops), edges + int((~keep).sum())
        change = followed_by(change, split_vertices(mesh, one[keep], other[keep]))


def _shortest_loops(
    mesh: HalfEdgeMesh, one: NDArray[Any], other: NDArray[Any], sides: Sides
) -> list[NDArray[Any]]:
    """Return a shortest one-sided loop of each one-sided component, as numbers of its two-face edges."""
    # Each fan of corners is a node; its sense of rotation is that of its first face.
    differ = mesh.origin[one] == mesh.origin[other]
    of_one, of_other = corners_at_ends(mesh, one), corners_at_ends(mesh, other)
    ends = np.concatenate(of_one), np.concatenate(of_other)
    fans = find_sides(mesh.faces.size, ends[0], ends[1], np.tile(differ, 2))
    corner, fan = np.unique(fans.label, return_index=True, return_inverse=True)[1:]
    rim = mesh.edge_halfedges[np.repeat(mesh.multiplicity != 2, mesh.multiplicity)]
    after = next_in_face(rim)
    rims = find_sides(len(corner), fan[rim], fan[after], fans.other[rim] != fans.other[after])
    on_rim = np.unique(fan[np.concatenate([rim, after])])
    rim_node = len(corner) + rims.label
    start, end = (fan[corners] for corners in of_one)
    first, second = np.concatenate([start, on_rim]), np.concatenate([end, rim_node[on_rim]])
    odd = np.concatenate([np.not_equal(*(fans.other[corners] for corners in of_one)), rims.other[on_rim]])
    length = np.concatenate([np.ones(len(one)), np.full(len(on_rim), _RIM)])
    component = sides.label[face_of(np.concatenate([one, corner[on_rim]]))]
    clash = differ ^ sides.other[face_of(one)] ^ sides.other[face_of(other)]
    found = []
    for label in np.unique(sides.label[sides.one_sided]):
        steps = np.flatnonzero(component == label)
        met = steps[: np.searchsorted(steps, len(one))]
        met = met[clash[met]]
        starts = np.union1d(start[met], end[met])
        starts = np.union1d(starts, rim_node[np.intersect1d(starts, on_rim)])
        loop = steps[_shortest_odd_loop(first[steps], second[steps], odd[steps], length[steps], starts)]
        found.append(loop[loop < len(one)])
    return found


def _shortest_odd_loop(
    first: NDArray[Any],
    second: NDArray[Any],
    odd: NDArray[np.bool_],
    length: NDArray[np.float64],
    starts: NDArray[Any],
) -> NDArray[Any]:
    """Return the steps of a shortest loop through a start that takes an odd number of `odd` steps.

    Steps join nodes `first` and `second` (n,). Each node stands for two, by how many odd steps led to it, and
    a loop leads from one of them to the other.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    nodes, number = np.unique(np.concatenate([first, second]), return_inverse=True)
    a, b = number[: len(first)], number[len(first) :]
    size = len(nodes)
    rows, columns = np.concatenate([a, a + size]), np.concatenate([b + size * odd, b + size * ~odd])
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    step = np.tile(np.arange(len(first)), 2)
    order = np.lexsort((step, high, low))
    order = order[np.r_[True, (np.diff(low[order]) != 0) | (np.diff(high[order]) != 0)]]
    low, high, step = low[order], high[order], step[order]
    graph = csr_array((np.tile(length, 2)[order], (low, high)), shape=(2 * size, 2 * size))
    starts = np.flatnonzero(np.isin(nodes, starts))
    starts = starts[:: 1 + 2 * size * len(starts) // _VISITS]
    best, came, begin = np.inf, np.zeros(0, np.int32), 0
    for start in starts:
        far, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True, limit=best)
        if far[start + size] < best:
            best, came, begin = far[start + size], before, start
    loop, at = [], begin + size
    while at != begin:
        back = int(came[at])
        pair = min(at, back), max(at, back)
        loop.append(step[np.searchsorted(low * np.int64(2 * size) + high, pair[0] * 2 * size + pair[1])])
        at = back
    taken, times = np.unique(loop, return_counts=True)
    return np.asarray(taken[times % 2 == 1])
