"""What a change of a mesh deleted, added and cut, by the places of the corners: whoever made it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import build_half_edges
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
    _, place = merged_vertices(
        np.concatenate([np.asarray(points, np.float64) for points, _ in (before, after)]), "exact"
    )
    places = np.split(place, [len(before[0])])
    rows = [np.sort(where[faces], axis=1) for where, (_, faces) in zip(places, (before, after), strict=True)]
    surplus = _surplus(*rows), _surplus(*rows[::-1])
    edges = [build_half_edges(faces, len(points)).edge_vertices for points, faces in (before, after)]
    old, new = (np.sort(where[ends], axis=1) for where, ends in zip(places, edges, strict=True))
    more = new[_surplus(new, old)]
    # Of edges in one place the first stands for all.
    return Difference(surplus[0], surplus[1], _first_of(old, more))


def _surplus(rows: NDArray[Any], other: NDArray[Any]) -> NDArray[np.int64]:
    """Return which of `rows` (n, k) are there more often than in `other`: the last ones."""
    _, group = np.unique(np.concatenate([rows, other]), axis=0, return_inverse=True)
    own, theirs = np.split(group.reshape(-1), [len(rows)])
    order = np.argsort(own, kind="stable")
    own = own[order]
    # The rank of each row among the equal ones before it; as many as `other` has are no surplus.
    rank = np.arange(len(own)) - np.searchsorted(own, own)
    return np.sort(order[rank >= np.bincount(theirs, minlength=len(group))[own]])


def _first_of(rows: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number of the first of `rows` (n, k) that equals each of `wanted`, where there is one."""
    _, group = np.unique(np.concatenate([rows, wanted]), axis=0, return_inverse=True)
    own, theirs = np.split(group.reshape(-1), [len(rows)])
    groups, first = np.unique(own, return_index=True)
    return np.sort(first[np.isin(groups, theirs)])
