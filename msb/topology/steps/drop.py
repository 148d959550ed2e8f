"""Remove faces until no edge has more than two: few of them, and none that could be put back."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.faces import face_areas
from msb.topology.halfedge import NONE, build_half_edges
from msb.topology.steps.change import Change, followed_by, with_faces
from msb.topology.steps.cut import cut

# Number of rounds after which what is in nobody's way is chosen more freely, so that chains end.
_ROUNDS = 64


def drop(points: NDArray[Any], faces: NDArray[Any], *, weights: NDArray[Any] | None = None) -> Change:
    """Remove faces at edges of more than two, then give vertices where surfaces only touch a copy at the end.

    Of faces that stand in the way alike those of less weight (F,) go first; of less area if that is not
    given. Fewest faces in all is a hard problem (it contains matching in hypergraphs). This is a greedy
    choice, followed by putting back whatever fits, so no removed face could return. Faces go first that have
    most edges of more than two faces; those are chosen side by side wherever they share no such edge. O(F log
    F) time for each round, of which there are few.
    """
    mesh = build_half_edges(faces, len(points))
    weight = face_areas(points, faces)[0] if weights is None else np.asarray(weights, np.float64)
    keep = np.ones(len(faces), bool)
    if (mesh.multiplicity > 2).any():
        edges = mesh.edge.reshape(-1, 3)
        _remove(keep, edges, mesh.multiplicity, weight)
        _put_back(keep, edges, mesh.edge_count, weight)
    change = with_faces(faces, keep, len(points))
    return followed_by(change, cut(change.faces, len(change.vertex_map)))


def _remove(
    keep: NDArray[np.bool_], edges: NDArray[Any], multiplicity: NDArray[Any], weight: NDArray[np.float64]
) -> None:
    """Clear `keep` of faces until no edge has more than two; at no edge more go than must."""
    count = multiplicity.copy()
    turn = 0
    while True:
        face, edge = _at(edges, np.flatnonzero(keep), count > 2)
        if len(face) == 0:
            return
        score = np.bincount(face, minlength=len(keep))
        among = np.flatnonzero(score)
        order = np.lexsort((_scrambled(among), weight[among], -score[among]))
        first = _first_in_line(face, edge, among[order], len(keep), count - 2)
        going = np.bincount(face[first], minlength=len(keep))
        gone = np.flatnonzero((going > 0) & ((going == score) | (turn >= _ROUNDS)))
        keep[gone] = False
        count -= np.bincount(edges[gone].reshape(-1), minlength=len(count)).astype(count.dtype)
        turn += 1


def _put_back(
    keep: NDArray[np.bool_], edges: NDArray[Any], edge_count: int, weight: NDArray[np.float64]
) -> None:
    """Set `keep` of removed faces that fit again, the weighty ones first."""
    proper = keep & (edges[:, 0] != NONE)
    count = np.bincount(edges[proper].reshape(-1), minlength=edge_count)
    turn = 0
    while True:
        out = np.flatnonzero(~keep)
        out = out[(count[edges[out]] < 2).all(axis=1)]
        if len(out) == 0:
            return
        face, edge = np.repeat(out, 3), edges[out].reshape(-1)
        ties = _scrambled(out)
        order = np.lexsort((ties, -weight[out])) if turn < _ROUNDS else np.argsort(ties)
        first = _first_in_line(face, edge, out[order], len(keep), 2 - count)
        back = np.flatnonzero(np.bincount(face[first], minlength=len(keep)) == 3)
        keep[back] = True
        count += np.bincount(edges[back].reshape(-1), minlength=edge_count)
        turn += 1


def _at(
    edges: NDArray[Any], faces: NDArray[Any], wanted: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return face and edge wherever one of `faces` has a wanted edge."""
    faces = faces[edges[faces, 0] != NONE]
    place = np.flatnonzero(wanted[edges[faces]])
    return faces[place // 3], edges[faces].reshape(-1)[place]


def _first_in_line(
    face: NDArray[Any], edge: NDArray[Any], line: NDArray[Any], face_count: int, room: NDArray[Any]
) -> NDArray[Any]:
    """Return the entries (face, edge) whose face is among the first ``room[edge]`` of its edge in `line`."""
    place = np.zeros(face_count, np.int64)
    place[line] = np.arange(len(line))
    order = np.lexsort((place[face], edge))
    sorted_edge = edge[order]
    start = np.searchsorted(sorted_edge, sorted_edge)
    return np.asarray(order[np.arange(len(order)) - start < room[sorted_edge]])


def _scrambled(numbers: NDArray[Any]) -> NDArray[np.uint32]:
    """Return numbers in no order, the same in every run: neighbours do not wait for each other in a row."""
    return numbers.astype(np.uint32) * np.uint32(2654435761)
