"""What a change of a mesh deleted, added and cut, by the places of the corners: whoever made it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import HalfEdgeMesh, build_half_edges
from msb.topology.weld import merged_vertices


@dataclass(frozen=True)
class Difference:
    """What is different between a mesh before and after.

    `deleted` faces and `cut` edges are numbers of before, `added` faces of after. A cut edge, by its place in
    `HalfEdgeMesh.edge_vertices`, is more edges in one place now.
    """

    deleted: NDArray[np.int64]
    added: NDArray[np.int64]
    cut: NDArray[np.int64]


def find_difference(
    before: tuple[NDArray[Any], NDArray[Any]], after: tuple[NDArray[Any], NDArray[Any]]
) -> Difference:
    """Return what was deleted, added and cut, of meshes as `mesh_arrays` returns them.

    Two corners are the same if their float32 coordinates are equal, so numbers of vertices, their order and
    their copies do not matter, nor does the winding of faces. Of faces in one place the last ones count as
    deleted or added. O((V + F) log (V + F)) time.
    """
    counts = [len(points) for points, _ in (before, after)]
    _, place = merged_vertices(
        np.concatenate([np.asarray(points, np.float64) for points, _ in (before, after)]), "exact"
    )
    places = np.split(place, [counts[0]])
    rows = [np.sort(where[faces], axis=1) for where, (_, faces) in zip(places, (before, after), strict=True)]
    surplus = _surplus(*rows), _surplus(*rows[::-1])
    meshes = [
        build_half_edges(faces, count) for count, (_, faces) in zip(counts, (before, after), strict=True)
    ]
    old, new = (_edge_rows(mesh, where) for mesh, where in zip(meshes, places, strict=True))
    more = new[_surplus(new, old)]
    # Of edges in one place the first stands for all.
    return Difference(surplus[0], surplus[1], _first_of(old, more))


def _edge_rows(mesh: HalfEdgeMesh, place: NDArray[Any]) -> NDArray[Any]:
    return np.sort(place[mesh.edge_vertices], axis=1)


def _surplus(rows: NDArray[Any], other: NDArray[Any]) -> NDArray[np.int64]:
    """Return which of `rows` (n, k) are there more often than in `other`: the last ones."""
    both = np.concatenate([other, rows])
    theirs = len(other)
    order = np.lexsort((np.arange(len(both)), *both.T[::-1]))
    group = _group(both[order])
    size = np.bincount(group) if len(group) else np.zeros(0, np.int64)
    own = order >= theirs
    counted = np.bincount(group[~own], minlength=len(size))
    # Within a group others come first, as their numbers are lower: rank of own rows from 0.
    rank = np.arange(len(order)) - np.repeat(np.cumsum(size) - size, size) - counted[group]
    return np.sort(order[own & (rank >= counted[group])] - theirs)


def _first_of(rows: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number of the first of `rows` (n, k) that equals each of `wanted`, where there is one."""
    both = np.concatenate([rows, wanted])
    order = np.lexsort((np.arange(len(both)), *both.T[::-1]))
    group = _group(both[order])
    first = order[np.flatnonzero(np.diff(group, prepend=-1))] if len(group) else order
    groups = np.unique(group[order >= len(rows)])
    firsts = first[groups]
    return np.sort(firsts[firsts < len(rows)])


def _group(ordered: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number of the run of equal rows that each row is in."""
    differs = np.zeros(len(ordered), np.int64)
    differs[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return np.cumsum(differs)
