"""Cut what is one-sided, like a Moebius strip, along short loops of edges until it has two sides.

Walking along edges carries a sense of rotation from vertex to vertex. A loop that comes back with the other
one is one-sided, and a surface cut along it is one-sided at fewer places. A hole of a surface counts as one
vertex with all of its rim, so that a cut from rim to rim is a loop, too: a strip is cut across and not
lengthwise. The edges across which the windings of two faces disagree, whichever faces are turned, meet every
such loop, so the shortest begins at one of their ends. Many loops are found at once, and those are cut
without which the pieces between them would not fit together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import corners_at_ends
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of, next_in_face
from msb.topology.steps.change import Change, followed_by, unchanged
from msb.topology.steps.cut import split_vertices
from msb.topology.steps.sides import Sides, find_sides, sides_of_faces

# From so many visited places on, a search for loops goes on from every second start.
_VISITS = 500_000


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
        loops = _loops_to_cut(mesh, one, other, sides)
        keep = np.ones(len(one), bool)
        keep[np.concatenate(loops)] = False
        cuts, edges = cuts + len(loops), edges + int((~keep).sum())
        change = followed_by(change, split_vertices(mesh, one[keep], other[keep]))


def _loops_to_cut(
    mesh: HalfEdgeMesh, one: NDArray[Any], other: NDArray[Any], sides: Sides
) -> list[NDArray[Any]]:
    """Return shortest loops of each one-sided component, as numbers of its two-face edges, none to spare."""
    differ = mesh.origin[one] == mesh.origin[other]
    face, beyond = face_of(one), face_of(other)
    clash = differ ^ sides.other[face] ^ sides.other[beyond]
    # Corners round a vertex are one node, and so are all along a rim. Those of a face turn in one sense.
    (low, high), across = corners_at_ends(mesh, one), corners_at_ends(mesh, other)
    rim = mesh.edge_halfedges[np.repeat(mesh.multiplicity != 2, mesh.multiplicity)]
    pairs = np.concatenate([low, high, rim]), np.concatenate([*across, next_in_face(rim)])
    nodes = find_sides(mesh.faces.size, *pairs, np.r_[differ, differ, np.zeros(len(rim), bool)])
    inside = np.flatnonzero(sides.one_sided[face])
    low, high = low[inside], high[inside]
    odd = nodes.other[low] != nodes.other[high]
    component, passed = sides.label[face[inside]], np.stack([mesh.origin[low], mesh.origin[high]], axis=1)
    steps = _Steps(nodes.label[low], nodes.label[high], odd, component, clash[inside], passed)
    loops = [inside[loop] for loop in _shortest_odd_loops(steps)]

    # Between the pieces that all loops leave, those loops are to spare across which the pieces fit together.
    cut = np.concatenate(loops)
    rest = np.delete(np.arange(len(one)), cut)
    pieces = find_sides(mesh.face_count, face[rest], beyond[rest], differ[rest])
    a, b = pieces.label[face[cut]], pieces.label[beyond[cut]]
    differ = differ[cut] ^ pieces.other[face[cut]] ^ pieces.other[beyond[cut]]
    joined = find_sides(mesh.face_count, a, b, differ)
    clash = differ ^ joined.other[a] ^ joined.other[b]
    needed = np.logical_or.reduceat(clash, np.cumsum([0, *map(len, loops[:-1])]))
    component = sides.label[face[[loop[0] for loop in loops]]]
    first = np.unique(component, return_index=True)[1]
    needed[first] |= ~np.isin(component[first], component[needed])
    return [loop for loop, is_needed in zip(loops, needed, strict=True) if is_needed]


@dataclass(frozen=True)
class _Steps:
    """Steps (n,) between two nodes: whether each is odd, its component, whether a search starts there.

    `passed` (n, 2) are the vertices at its ends: several may be one node.
    """

    one: NDArray[Any]
    other: NDArray[Any]
    odd: NDArray[np.bool_]
    component: NDArray[Any]
    start: NDArray[np.bool_]
    passed: NDArray[Any]


@dataclass(frozen=True)
class _Level:
    """The places (n,), sorted, that a search reaches at once, the row of the level before, and the step.

    A place is a start, a node, and whether an odd number of odd steps leads there, in one number.
    """

    place: NDArray[np.int64]
    before: NDArray[np.int32]
    step: NDArray[np.int32]

    def __getitem__(self, rows: NDArray[Any]) -> _Level:
        return _Level(self.place[rows], self.before[rows], self.step[rows])


def _shortest_odd_loops(steps: _Steps) -> list[NDArray[Any]]:
    """Return shortest loops of each component that take an odd number of odd steps and share no vertex.

    Every odd loop takes a step that is a start. One breadth-first search goes out from all starts, and where
    it reaches a node both ways from one, these ways are a loop. Loops are rows of `steps`.
    """
    nodes, ends = np.unique(np.concatenate([steps.one, steps.other]), return_inverse=True)
    count, size = len(steps.one), 2 * len(nodes)
    leaving = np.argsort(ends, kind="stable")
    first = np.searchsorted(ends, np.arange(len(nodes) + 1), sorter=leaving)
    to, step = ends[(leaving + count) % (2 * count)], (leaving % count).astype(np.int32)

    starts, rows = np.unique(ends[:count][steps.start], return_index=True)
    component = steps.component[steps.start][rows]
    none = np.zeros(0, np.int32)
    levels = [_Level(size * np.arange(len(starts)) + 2 * starts, none, none)]
    loops: list[NDArray[Any]] = []
    taken, visits = np.zeros(1 + steps.passed.max(), bool), 0
    while len(levels[-1].place):
        here = levels[-1].place
        node = here % size // 2
        ways = first[node + 1] - first[node]
        before = np.repeat(np.arange(len(here), dtype=np.int32), ways)
        way = np.arange(len(before)) + np.repeat(first[node] - np.cumsum(ways) + ways, ways)
        to_there = step[way]
        there = (here[before] + 2 * (to[way] - node[before])) ^ steps.odd[to_there]
        reached = _Level(there, before, to_there)
        new = np.unique(there, return_index=True)[1]
        new = new[~np.isin(there[new], np.concatenate([level.place for level in levels[-2:]]))]
        levels.append(reached[new])

        # A way and one that led to the same node by a number of the other kind close a loop.
        alive = np.ones(len(new), bool)
        start = levels[-1].place // size
        for mirror in (len(levels) - 2, len(levels) - 1):
            closing = np.flatnonzero(np.isin(there ^ 1, levels[mirror].place))
            closing = closing[~np.isin(component[there[closing] // size], component[start[~alive]])]
            closing = closing[np.unique(to_there[closing], return_index=True)[1]]
            back = np.searchsorted(levels[mirror].place, there[closing] ^ 1)
            both = [_steps_to([*levels[:-1], reached], closing), _steps_to(levels[: mirror + 1], back)]
            for loop in np.concatenate(both, axis=1):
                passed = steps.passed[loop]
                if not taken[passed].any():
                    taken[passed] = True
                    once, times = np.unique(loop, return_counts=True)
                    loops.append(once[times % 2 == 1])
            alive &= ~np.isin(component[start], component[there[closing] // size])
        visits += len(start)
        if visits > _VISITS and len(left := np.unique(start[alive])) > 1:
            visits //= 2
            alive &= np.isin(start, left[::2])
        levels[-1] = levels[-1][alive]
    return loops


def _steps_to(levels: list[_Level], row: NDArray[Any]) -> NDArray[np.int32]:
    """Return the steps (rows, levels - 1) that led to rows of the last level."""
    steps = np.zeros((len(row), len(levels) - 1), np.int32)
    for number in range(len(levels) - 1, 0, -1):
        steps[:, number - 1] = levels[number].step[row]
        row = levels[number].before[row]
    return steps
