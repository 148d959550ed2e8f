"""Remove faces until no edge has more than two faces. The choice of faces is greedy and removes few faces."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.faces import face_areas
from msb.topology.halfedge import NONE, build_half_edges
from msb.topology.steps.change import Change, followed_by, with_faces
from msb.topology.steps.cut import cut

# Number of rounds with the strict choice of faces. Later rounds choose faces by a weaker rule. With the
# strict rule, faces can wait for each other, and a long chain of such faces takes one round per face.
_ROUNDS = 64


def drop(points: NDArray[Any], faces: NDArray[Any], *, weights: NDArray[Any] | None = None) -> Change:
    """Remove faces at edges with more than two faces.

    After the removal, copy the vertices where surfaces only touch. First remove the faces that touch the most
    edges with more than two faces. Among faces with equal numbers of such edges, the face with the smallest
    weight (F,) is removed first. The default weight of a face is its area. The choice is greedy, because
    finding the smallest set of faces is NP-hard (the problem contains hypergraph matching). Afterwards,
    removed faces are restored as long as no edge gets a third face. Each round removes many faces that do not
    share edges of three or more faces. The step takes few rounds, and each round takes O(F log F) time.
    Copies of vertices come last.
    """
    mesh = build_half_edges(faces, len(points))
    weight = face_areas(points, faces)[0] if weights is None else np.asarray(weights, np.float64)
    keep = np.ones(len(faces), bool)
    if (mesh.multiplicity > 2).any():
        edges = mesh.edge.reshape(-1, 3)
        _remove(keep, edges, mesh.multiplicity, weight)
        _restore(keep, edges, mesh.edge_count, weight)
    change = with_faces(faces, keep, len(points))
    return followed_by(change, cut(change.faces, len(change.vertex_map)))


def _remove(
    keep: NDArray[np.bool_], edges: NDArray[Any], multiplicity: NDArray[Any], weight: NDArray[np.float64]
) -> None:
    """Clear `keep` for some faces until no edge has more than two faces. No edge loses more faces than
    necessary."""
    count = multiplicity.copy()
    round_number = 0
    while True:
        face, edge = _list_faces_at(edges, np.flatnonzero(keep), count > 2)
        if len(face) == 0:
            return
        # `order` lists faces with many crowded edges first, then faces with a small weight.
        score = np.bincount(face, minlength=len(keep))
        among = np.flatnonzero(score)
        order = np.lexsort((_scramble(among), weight[among], -score[among]))
        first = _take_first_in_line(face, edge, among[order], len(keep), count - 2)
        # A face is removed only if it is among the first faces in `order` at each of its crowded edges.
        going = np.bincount(face[first], minlength=len(keep))
        gone = np.flatnonzero((going > 0) & ((going == score) | (round_number >= _ROUNDS)))
        keep[gone] = False
        count -= np.bincount(edges[gone].reshape(-1), minlength=len(count)).astype(count.dtype)
        round_number += 1


def _restore(
    keep: NDArray[np.bool_], edges: NDArray[Any], edge_count: int, weight: NDArray[np.float64]
) -> None:
    """Set `keep` for removed faces that can be restored. Faces with a large weight are restored first."""
    proper = keep & (edges[:, 0] != NONE)
    count = np.bincount(edges[proper].reshape(-1), minlength=edge_count)
    round_number = 0
    while True:
        out = np.flatnonzero(~keep)
        out = out[(count[edges[out]] < 2).all(axis=1)]
        if len(out) == 0:
            return
        # A face is restored only if it is among the first faces in the order at each of its three edges.
        face, edge = np.repeat(out, 3), edges[out].reshape(-1)
        ties = _scramble(out)
        order = np.lexsort((ties, -weight[out])) if round_number < _ROUNDS else np.argsort(ties)
        first = _take_first_in_line(face, edge, out[order], len(keep), 2 - count)
        back = np.flatnonzero(np.bincount(face[first], minlength=len(keep)) == 3)
        keep[back] = True
        count += np.bincount(edges[back].reshape(-1), minlength=edge_count)
        round_number += 1


def _list_faces_at(
    edges: NDArray[Any], faces: NDArray[Any], wanted: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Find all edges that are marked in `wanted` (E,). Return the pairs of a face (n,) and such an edge
    (n,)."""
    faces = faces[edges[faces, 0] != NONE]
    place = np.flatnonzero(wanted[edges[faces]])
    return faces[place // 3], edges[faces].reshape(-1)[place]


def _take_first_in_line(
    face: NDArray[Any], edge: NDArray[Any], line: NDArray[Any], face_count: int, room: NDArray[Any]
) -> NDArray[Any]:
    """At each edge, select the first ``room[edge]`` faces in the order of `line`. Return the selected pairs
    (face, edge)."""
    place = np.zeros(face_count, np.int64)
    place[line] = np.arange(len(line))
    order = np.lexsort((place[face], edge))
    sorted_edge = edge[order]
    start = np.searchsorted(sorted_edge, sorted_edge)
    return np.asarray(order[np.arange(len(order)) - start < room[sorted_edge]])


def _scramble(numbers: NDArray[Any]) -> NDArray[np.uint32]:
    """Return reproducible pseudo-random numbers, which decide between equal faces.

    Without these numbers, neighbouring faces would wait for each other for many rounds.
    """
    return numbers.astype(np.uint32) * np.uint32(2654435761)
