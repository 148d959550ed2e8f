"""Texture coordinates of corners as those of vertices, which most formats and every engine want."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.meshes.mesh import Mesh


def with_vertex_uvs(mesh: Mesh) -> Mesh:
    """Return `mesh` with texture coordinates by vertex, and faces and vertices grouped by texture.

    A vertex is doubled where its corners differ in their coordinates, bit for bit, or in their texture. One
    of its rows stays among those of the mesh, in their order; the others follow the last of these in the
    order of the corners that want them. Faces keep their order within a group.
    """
    if mesh.corner_uvs is None and mesh.face_textures is None:
        return mesh
    if mesh.face_textures is None:
        order = np.arange(len(mesh.faces))
        textures = np.zeros(len(mesh.faces), np.int64)
    else:
        order = np.argsort(mesh.face_textures, kind="stable")
        textures = mesh.face_textures[order].astype(np.int64)
    corners = mesh.faces[order].reshape(-1)
    if mesh.corner_uvs is None:
        assert mesh.vertex_uvs is not None
        uvs = mesh.vertex_uvs[corners]
    else:
        uvs = mesh.corner_uvs.reshape(-1, 3, 2)[order].reshape(-1, 2)
    vertices, rows, numbers = _rows(corners, np.repeat(textures, 3), uvs, len(mesh.vertices))
    colors = mesh.vertex_colors
    return replace(
        mesh,
        vertices=mesh.vertices[vertices],
        faces=numbers.reshape(-1, 3),
        vertex_colors=None if colors is None else colors[vertices],
        face_colors=None if mesh.face_colors is None else mesh.face_colors[order],
        vertex_uvs=rows,
        corner_uvs=None,
        face_textures=None if mesh.face_textures is None else mesh.face_textures[order],
    )


def _rows(
    corners: NDArray[np.int64], textures: NDArray[np.int64], uvs: NDArray[np.float32], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """Return the vertex (N,) and coordinates (N, 2) of each row that corners (C,) need, and their rows (C,).

    Corners, of `count` vertices, are grouped by texture already.
    """
    bits = np.ascontiguousarray(uvs).view(np.uint64)[:, 0]
    by = np.lexsort((bits, textures, corners))  # of equal corners the first comes first
    differs = np.ones(len(by), bool)
    same = [values[by[1:]] == values[by[:-1]] for values in (bits, textures, corners)]
    differs[1:] = ~np.logical_and.reduce(same)
    first = by[differs]
    numbers = np.zeros(len(by), np.int64)
    numbers[by] = np.cumsum(differs) - 1

    vertices = corners[first]
    begins = np.flatnonzero(np.diff(vertices, prepend=-1))
    stays = np.zeros(len(first), bool)
    earliest = np.minimum.reduceat(first, begins)
    stays[np.isin(first, earliest, assume_unique=True)] = True
    used = np.zeros(count, bool)
    used[vertices] = True
    unused = np.flatnonzero(~used)

    vertices = np.concatenate((vertices, unused))
    stays = np.concatenate((stays, np.ones(len(unused), bool)))
    place = np.where(stays, vertices, np.concatenate((first, unused)))
    group = np.concatenate((textures[first], np.full(len(unused), textures.min(initial=0))))
    rank = np.lexsort((place, ~stays, group))
    moved = np.zeros(len(rank), np.int64)
    moved[rank] = np.arange(len(rank))
    rows = np.concatenate((uvs[first], np.zeros((len(unused), 2), np.float32)))
    return vertices[rank], rows[rank], moved[numbers]
