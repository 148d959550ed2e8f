"""Cut a mesh until it is manifold: vertices get copies, faces keep their places and lose nothing."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import group_corners
from msb.topology.halfedge import NONE, HalfEdgeMesh, build_half_edges
from msb.topology.steps.change import Change, with_vertices


def cut(faces: NDArray[Any], vertex_count: int) -> Change:
    """Give every fan a vertex of its own, by copies at the end; edges of more than two faces come apart.

    Edges of two faces are kept, so the walk around a vertex that `find_fans` makes is the walk across what
    remains. Two fans of a vertex share no edge afterwards. At an edge of more than two faces at most two stay
    together, namely where one fan begins and ends at it at both of its vertices: a fan that is a path has two
    ends. So the result is manifold, and a manifold mesh is not changed. O(F log F) time.
    """
    mesh = build_half_edges(faces, vertex_count)
    return split_vertices(mesh, *mesh.two_face_halfedges)


def split_vertices(mesh: HalfEdgeMesh, one: NDArray[Any], other: NDArray[Any]) -> Change:
    """Return the change that keeps faces together at the given pairs of half-edges alone.

    The first group of corners of a vertex keeps its number; each further one gets a copy. Faces that name a
    vertex twice keep their vertices.
    """
    faces = mesh.faces
    count, group = group_corners(mesh, one, other)
    corners = np.flatnonzero(group != NONE)
    group_vertex = np.zeros(count, faces.dtype)
    group_vertex[group[corners]] = mesh.origin[corners]
    _, first = np.unique(group_vertex, return_index=True)  # groups are numbered by their first corner
    copied = np.ones(count, bool)
    copied[first] = False
    copies = group_vertex[copied]
    total = mesh.vertex_count + len(copies)
    number = group_vertex if total < 2**31 else group_vertex.astype(np.int64)
    number[copied] = np.arange(mesh.vertex_count, total)
    new = faces.reshape(-1).astype(number.dtype)
    new[corners] = number[group[corners]]
    vertex_map = np.concatenate([np.arange(mesh.vertex_count), copies])
    return with_vertices(new.reshape(-1, 3), vertex_map)


def cut_edges(faces: NDArray[Any], vertex_map: NDArray[Any]) -> NDArray[Any]:
    """Return the (n, 2) old vertices of the edges that became several, for faces by new vertices.

    `vertex_map` has the old vertex of each new one; edges with an added vertex (NONE) are left out.
    """
    mesh = build_half_edges(faces, len(vertex_map))
    ends = np.sort(vertex_map[mesh.edge_vertices], axis=1)
    ends = ends[ends[:, 0] != NONE]
    ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
    again = np.zeros(len(ends), bool)
    again[1:] = (ends[1:] == ends[:-1]).all(axis=1)
    return np.unique(ends[again], axis=0)
