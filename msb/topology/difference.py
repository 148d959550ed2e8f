"""The faces and edges that differ between two versions of a mesh. Faces and edges are compared by their
corner positions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import build_half_edges
from msb.topology.weld import merge_coincident


@dataclass(frozen=True)
class Difference:
    """The differences between a mesh before and after a change.

    Attributes
    ----------
    deleted : (n,) int64
        Indices of the faces of the old mesh that are missing in the new mesh.
    added : (n,) int64
        Indices of the faces of the new mesh that are missing in the old mesh.
    cut : (n,) int64
        Edges of the old mesh that became several edges, as indices into `HalfEdgeMesh.edge_vertices`.
    """

    deleted: NDArray[np.int64]
    added: NDArray[np.int64]
    cut: NDArray[np.int64]


def find_difference(
    before: tuple[NDArray[Any], NDArray[Any]], after: tuple[NDArray[Any], NDArray[Any]]
) -> Difference:
    """Return the faces that were deleted or added, and the edges that were cut.

    The arguments `before` and `after` are vertices and faces returned by `mesh_arrays`. Corners are equal if
    their stored coordinates are equal (`weld_vertices`). Vertex numbers, vertex order, duplicated vertices
    and the winding of faces are ignored. Coincident faces may be deleted or added in part, for example k of n
    faces. The result then contains the k faces with the highest indices. The comparison takes O((V + F) log
    (V + F)) time.
    """
    # Number the positions of both meshes together. Describe each face by its sorted position numbers.
    _, place = merge_coincident(
        np.concatenate([np.asarray(points, np.float64) for points, _ in (before, after)]), "exact"
    )
    places = np.split(place, [len(before[0])])
    rows = [np.sort(where[faces], axis=1) for where, (_, faces) in zip(places, (before, after), strict=True)]
    surplus = _find_surplus(*rows), _find_surplus(*rows[::-1])
    # An edge was cut if several coincident edges replace it. Return the first old edge at the position of
    # each cut edge.
    edges = [build_half_edges(faces, len(points)).edge_vertices for points, faces in (before, after)]
    old, new = (np.sort(where[ends], axis=1) for where, ends in zip(places, edges, strict=True))
    more = new[_find_surplus(new, old)]
    return Difference(surplus[0], surplus[1], _find_first(old, more))


def _find_surplus(rows: NDArray[Any], other: NDArray[Any]) -> NDArray[np.int64]:
    """Return the indices of the rows of `rows` (n, k) that have no counterpart in `other`.

    If `rows` contains equal rows, the last of these rows are returned.
    """
    _, group = np.unique(np.concatenate([rows, other]), axis=0, return_inverse=True)
    group_of_row, group_of_other = np.split(group.reshape(-1), [len(rows)])
    order = np.argsort(group_of_row, kind="stable")
    group_of_row = group_of_row[order]
    # `rank` counts the equal rows before each row. A row is surplus if `other` has at most `rank` equal
    # rows.
    rank = np.arange(len(group_of_row)) - np.searchsorted(group_of_row, group_of_row)
    return np.sort(order[rank >= np.bincount(group_of_other, minlength=len(group))[group_of_row]])


def _find_first(rows: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.int64]:
    """For each row of `wanted`, return the index of the first equal row in `rows` (n, k).

    Rows of `wanted` without an equal row are skipped.
    """
    _, group = np.unique(np.concatenate([rows, wanted]), axis=0, return_inverse=True)
    group_of_row, group_of_wanted = np.split(group.reshape(-1), [len(rows)])
    groups, first = np.unique(group_of_row, return_index=True)
    return np.sort(first[np.isin(groups, group_of_wanted)])
