"""Remove faces until no edge has more than two: few faces, and none that could be restored."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.faces import face_areas
from msb.topology.halfedge import NONE, build_half_edges
from msb.topology.steps.change import Change, followed_by, with_faces
from msb.topology.steps.cut import cut

# Rounds after which faces are chosen more freely, so that long chains of dependencies end.
_ROUNDS = 64


def drop(points: NDArray[Any], faces: NDArray[Any], *, weights: NDArray[Any] | None = None) -> Change:
    """Remove faces at edges with more than two faces, then copy vertices where surfaces only touch.

    Faces on most such edges are removed first; among equals, faces with a small weight (F,) come first,
    by default the area. Finding the smallest set of faces is a hard problem (it contains hypergraph
    matching), so the choice is greedy. Afterwards every face that fits again is restored, so no removed face
    could return. Each round removes many faces that share no such edge. Takes O(F log F) time per round, with
    few rounds. Copies of vertices come last.
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
    """Clear `keep` for faces until no edge has more than two; no edge loses more faces than necessary."""
    count = multiplicity.copy()
    round_number = 0
    while True:
        face, edge = _at(edges, np.flatnonzero(keep), count > 2)
        if len(face) == 0:
            return
        # Line up the faces by their number of crowded edges, then by weight.
        score = np.bincount(face, minlength=len(keep))
        among = np.flatnonzero(score)
        order = np.lexsort((_scrambled(among), weight[among], -score[among]))
        first = _first_in_line(face, edge, among[order], len(keep), count - 2)
        # Remove a face only if it is among the first in line at all of its crowded edges.
        going = np.bincount(face[first], minlength=len(keep))
        gone = np.flatnonzero((going > 0) & ((going == score) | (round_number >= _ROUNDS)))
        keep[gone] = False
        count -= np.bincount(edges[gone].reshape(-1), minlength=len(count)).astype(count.dtype)
        round_number += 1


def _put_back(
    keep: NDArray[np.bool_], edges: NDArray[Any], edge_count: int, weight: NDArray[np.float64]
) -> None:
    """Set `keep` for removed faces that fit again, heavy faces first."""
    proper = keep & (edges[:, 0] != NONE)
    count = np.bincount(edges[proper].reshape(-1), minlength=edge_count)
    round_number = 0
    while True:
        out = np.flatnonzero(~keep)
        out = out[(count[edges[out]] < 2).all(axis=1)]
        if len(out) == 0:
            return
        # Restore a face only if it is among the first in line at all three edges.
        face, edge = np.repeat(out, 3), edges[out].reshape(-1)
        ties = _scrambled(out)
        order = np.lexsort((ties, -weight[out])) if round_number < _ROUNDS else np.argsort(ties)
        first = _first_in_line(face, edge, out[order], len(keep), 2 - count)
        back = np.flatnonzero(np.bincount(face[first], minlength=len(keep)) == 3)
        keep[back] = True
        count += np.bincount(edges[back].reshape(-1), minlength=edge_count)
        round_number += 1


def _at(
    edges: NDArray[Any], faces: NDArray[Any], wanted: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return face and edge, both (n,), for each wanted edge of `faces`."""
    faces = faces[edges[faces, 0] != NONE]
    place = np.flatnonzero(wanted[edges[faces]])
    return faces[place // 3], edges[faces].reshape(-1)[place]


def _first_in_line(
    face: NDArray[Any], edge: NDArray[Any], line: NDArray[Any], face_count: int, room: NDArray[Any]
) -> NDArray[Any]:
    """Return the entries (face, edge) with a face among the first ``room[edge]`` faces of its edge.

    `line` lists faces in order of preference.
    """
    place = np.zeros(face_count, np.int64)
    place[line] = np.arange(len(line))
    order = np.lexsort((place[face], edge))
    sorted_edge = edge[order]
    start = np.searchsorted(sorted_edge, sorted_edge)
    return np.asarray(order[np.arange(len(order)) - start < room[sorted_edge]])


def _scrambled(numbers: NDArray[Any]) -> NDArray[np.uint32]:
    """Return pseudo-random numbers, equal in every run, so that no long queue of neighbours forms."""
    return numbers.astype(np.uint32) * np.uint32(2654435761)
