"""Cut one-sided surfaces, such as Moebius strips, along short loops of edges until they have two sides.

A walk along edges transports a sense of rotation from vertex to vertex. A loop is one-sided if the sense of
rotation is reversed after one turn along the loop. A cut along a one-sided loop removes the loop. The search
treats all vertices along the rim of a hole as one vertex. A cut from one rim to another rim is therefore a
loop as well. A Moebius strip is cut across its width.

Turning faces never makes a one-sided loop consistent. The loop always passes an edge whose two faces have
opposite windings. The search for short loops therefore starts at edges whose two faces have opposite
windings. The search finds many loops in one pass. A loop of edges is cut only if its two sides cannot be
wound consistently.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import find_end_corners
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of, next_in_face
from msb.topology.steps.change import Change, followed_by, unchanged
from msb.topology.steps.cut import split_vertices
from msb.topology.steps.sides import Sides, find_sides, find_sides_of_faces

# If the search visits more states than this, every second start is dropped to limit time and memory.
_VISITS = 500_000


def cut_one_sided(
    faces: NDArray[Any], vertex_count: int, *, only_manifold: bool = False
) -> tuple[Change, int, int]:
    """Return the change, the number of cuts, and the number of cut edges. After the cuts, no component is
    one-sided.

    Components are joined across two-face edges. Copies of the vertices along a cut are last. Faces keep their
    positions. A mesh without one-sided components is not changed. If `only_manifold` is true, a mesh with
    edges of more than two faces is not changed. A cut would separate all faces at such edges.
    """
    change, cuts, edges = unchanged(faces, vertex_count), 0, 0
    while True:
        mesh = build_half_edges(change.faces, len(change.vertex_map))
        sides = find_sides_of_faces(mesh)
        if not sides.one_sided.any() or (only_manifold and (mesh.multiplicity > 2).any()):
            return change, cuts, edges
        first, second = mesh.two_face_halfedges
        loops = _find_loops_to_cut(mesh, first, second, sides)
        keep = np.ones(len(first), bool)
        keep[np.concatenate(loops)] = False
        cuts, edges = cuts + len(loops), edges + int((~keep).sum())
        change = followed_by(change, split_vertices(mesh, first[keep], second[keep]))


def _find_loops_to_cut(
    mesh: HalfEdgeMesh, first: NDArray[Any], second: NDArray[Any], sides: Sides
) -> list[NDArray[Any]]:
    """For each one-sided component, return the shortest loops that must be cut.

    A loop is an array of two-face edges. The arguments `first` and `second` are the half-edges (E2,) of the
    two-face edges.
    """
    differ = mesh.origin[first] == mesh.origin[second]
    face, beyond = face_of(first), face_of(second)
    clash = differ ^ sides.other[face] ^ sides.other[beyond]
    # A node of the search is the set of all corners around a vertex, or along a rim. All corners of a face
    # have the same sense of rotation.
    (low, high), across = find_end_corners(mesh, first), find_end_corners(mesh, second)
    rim = mesh.edge_halfedges[np.repeat(mesh.multiplicity != 2, mesh.multiplicity)]
    pairs = np.concatenate([low, high, rim]), np.concatenate([*across, next_in_face(rim)])
    nodes = find_sides(mesh.faces.size, *pairs, np.r_[differ, differ, np.zeros(len(rim), bool)])
    # Each two-face edge of a one-sided component is a step. A step is odd if it reverses the sense of
    # rotation.
    inside = np.flatnonzero(sides.one_sided[face])
    low, high = low[inside], high[inside]
    odd = nodes.other[low] != nodes.other[high]
    component, passed = sides.label[face[inside]], np.stack([mesh.origin[low], mesh.origin[high]], axis=1)
    steps = _Steps(nodes.label[low], nodes.label[high], odd, component, clash[inside], passed)
    loops = [inside[loop] for loop in _find_shortest_odd_loops(steps)]

    # A loop need not be cut if the pieces on both sides of the loop can be wound consistently.
    cut = np.concatenate(loops)
    rest = np.delete(np.arange(len(first)), cut)
    pieces = find_sides(mesh.face_count, face[rest], beyond[rest], differ[rest])
    a, b = pieces.label[face[cut]], pieces.label[beyond[cut]]
    differ = differ[cut] ^ pieces.other[face[cut]] ^ pieces.other[beyond[cut]]
    joined = find_sides(mesh.face_count, a, b, differ)
    clash = differ ^ joined.other[a] ^ joined.other[b]
    needed = np.logical_or.reduceat(clash, np.cumsum([0, *map(len, loops[:-1])]))
    component = sides.label[face[[loop[0] for loop in loops]]]
    first_loops = np.unique(component, return_index=True)[1]
    needed[first_loops] |= ~np.isin(component[first_loops], component[needed])
    return [loop for loop, is_needed in zip(loops, needed, strict=True) if is_needed]


@dataclass(frozen=True)
class _Steps:
    """The steps (n,) of the search. Each step connects two nodes.

    Attributes
    ----------
    near, far : (n,) integers
        The two nodes that each step connects.
    odd : (n,) bool
        Whether the step reverses the sense of rotation.
    component : (n,) integers
    start : (n,) bool
        Whether searches start at this step.
    passed : (n, 2) integers
        The two vertices that each step connects. A node may consist of several vertices.
    """

    near: NDArray[Any]
    far: NDArray[Any]
    odd: NDArray[np.bool_]
    component: NDArray[Any]
    start: NDArray[np.bool_]
    passed: NDArray[Any]


@dataclass(frozen=True)
class _Level:
    """One level of a breadth-first search: the sorted states `place` (n,) that are reached after some number
    of steps.

    A search state is one number for three values: the start, the node, and whether the number of odd steps so
    far is odd. The field `before` is the index of the previous state in the previous level. The field `step`
    is the step from the previous state to this state.
    """

    place: NDArray[np.int64]
    before: NDArray[np.int32]
    step: NDArray[np.int32]

    def __getitem__(self, rows: NDArray[Any]) -> _Level:
        return _Level(self.place[rows], self.before[rows], self.step[rows])


def _find_shortest_odd_loops(steps: _Steps) -> list[NDArray[Any]]:
    """Return short loops with an odd number of odd steps, as indices of `steps`.

    No two loops share a vertex. Every loop with an odd number of odd steps contains a start. A single
    breadth-first search runs from all starts. Two paths from one start may reach the same node. The two paths
    form an odd loop if their parities differ. The search in a component ends at the first level with a loop,
    because this loop is the shortest.
    """
    # The steps that leave each node are the range first[node] : first[node + 1].
    nodes, ends = np.unique(np.concatenate([steps.near, steps.far]), return_inverse=True)
    count, size = len(steps.near), 2 * len(nodes)
    leaving = np.argsort(ends, kind="stable")
    first = np.searchsorted(ends, np.arange(len(nodes) + 1), sorter=leaving)
    to, step = ends[(leaving + count) % (2 * count)], (leaving % count).astype(np.int32)

    # The first level contains every start with even parity.
    starts, rows = np.unique(ends[:count][steps.start], return_index=True)
    component = steps.component[steps.start][rows]
    none = np.zeros(0, np.int32)
    levels = [_Level(size * np.arange(len(starts)) + 2 * starts, none, none)]
    loops: list[NDArray[Any]] = []
    taken, visits = np.zeros(1 + steps.passed.max(), bool), 0
    while len(levels[-1].place):
        # Take every step that leaves the current states, and keep states that were not reached before.
        here = levels[-1].place
        node = here % size // 2
        exits = first[node + 1] - first[node]
        before = np.repeat(np.arange(len(here), dtype=np.int32), exits)
        exit_row = np.arange(len(before)) + np.repeat(first[node] - np.cumsum(exits) + exits, exits)
        step_taken = step[exit_row]
        there = (here[before] + 2 * (to[exit_row] - node[before])) ^ steps.odd[step_taken]
        reached = _Level(there, before, step_taken)
        new = np.unique(there, return_index=True)[1]
        new = new[~np.isin(there[new], np.concatenate([level.place for level in levels[-2:]]))]
        levels.append(reached[new])

        alive = np.ones(len(new), bool)
        start = levels[-1].place // size
        for mirror in (len(levels) - 2, len(levels) - 1):
            closing = np.flatnonzero(np.isin(there ^ 1, levels[mirror].place))
            closing = closing[~np.isin(component[there[closing] // size], component[start[~alive]])]
            closing = closing[np.unique(step_taken[closing], return_index=True)[1]]
            back = np.searchsorted(levels[mirror].place, there[closing] ^ 1)
            both = [_trace_steps([*levels[:-1], reached], closing), _trace_steps(levels[: mirror + 1], back)]
            for loop in np.concatenate(both, axis=1):
                passed = steps.passed[loop]
                if not taken[passed].any():
                    taken[passed] = True
                    once, times = np.unique(loop, return_counts=True)
                    loops.append(once[times % 2 == 1])
            alive &= ~np.isin(component[start], component[there[closing] // size])
        # Drop half of the starts when the search grows too large.
        visits += len(start)
        if visits > _VISITS and len(left := np.unique(start[alive])) > 1:
            visits //= 2
            alive &= np.isin(start, left[::2])
        levels[-1] = levels[-1][alive]
    return loops


def _trace_steps(levels: list[_Level], row: NDArray[Any]) -> NDArray[np.int32]:
    """Return the steps (rows, levels - 1) on the paths to the given rows of the last level."""
    steps = np.zeros((len(row), len(levels) - 1), np.int32)
    for number in range(len(levels) - 1, 0, -1):
        steps[:, number - 1] = levels[number].step[row]
        row = levels[number].before[row]
    return steps
