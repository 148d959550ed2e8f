"""Cut a mesh until it is manifold. The cut copies vertices, and faces keep their positions and attributes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import group_corners
from msb.topology.halfedge import NONE, HalfEdgeMesh, build_half_edges
from msb.topology.steps.change import Change, with_vertices


def cut(faces: NDArray[Any], vertex_count: int) -> Change:
    """Cut edges with more than two faces, and give every fan a separate vertex. Copied vertices come last.

    The result is manifold: two-face edges stay connected, and every fan gets a separate vertex. At an edge
    with more than two faces, only two faces can stay together. At both vertices of this edge, the two faces
    are the ends of one fan. A manifold mesh does not change. The step takes O(F log F) time.
    """
    mesh = build_half_edges(faces, vertex_count)
    return split_vertices(mesh, *mesh.two_face_halfedges)


def split_vertices(mesh: HalfEdgeMesh, first: NDArray[Any], second: NDArray[Any]) -> Change:
    """Separate all faces, except at the given pairs of half-edges. Return the change.

    The first group of corners at a vertex keeps the vertex index. Each further group of corners gets a copy
    of the vertex. Faces with a repeated index keep their vertices.
    """
    faces = mesh.faces
    count, group = group_corners(mesh, first, second)
    corners = np.flatnonzero(group != NONE)
    # The first group at each vertex keeps the vertex index. The indices of all other groups start at
    # vertex_count.
    group_vertex = np.zeros(count, faces.dtype)
    group_vertex[group[corners]] = mesh.origin[corners]
    _, keeps = np.unique(group_vertex, return_index=True)  # Groups are numbered by their first corner.
    copied = np.ones(count, bool)
    copied[keeps] = False
    copies = group_vertex[copied]
    total = mesh.vertex_count + len(copies)
    number = group_vertex if total < 2**31 else group_vertex.astype(np.int64)
    number[copied] = np.arange(mesh.vertex_count, total)
    new = faces.reshape(-1).astype(number.dtype)
    new[corners] = number[group[corners]]
    vertex_map = np.concatenate([np.arange(mesh.vertex_count), copies])
    return with_vertices(new.reshape(-1, 3), vertex_map)


def cut_edges(faces: NDArray[Any], vertex_map: NDArray[Any]) -> NDArray[Any]:
    """Some old edges became several edges in `faces`. Return the old end vertices (n, 2) of these edges.

    The argument `vertex_map` gives the old vertex of each new vertex. Edges with an added vertex (NONE) are
    ignored.
    """
    mesh = build_half_edges(faces, len(vertex_map))
    ends = np.sort(vertex_map[mesh.edge_vertices], axis=1)
    ends = ends[ends[:, 0] != NONE]
    ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
    again = np.zeros(len(ends), bool)
    again[1:] = (ends[1:] == ends[:-1]).all(axis=1)
    return np.unique(ends[again], axis=0)
