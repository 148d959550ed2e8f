"""Convert textures for formats that store UVs per vertex, and for formats with vertex colours only."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler, linear_to_srgb, mip_levels, sample
from msb.meshes.colors import linear_light, with_alpha
from msb.meshes.mesh import Mesh

# Mip level for sampling a texture at a corner, relative to the level that matches the size of the face. The
# value -1 is the next finer level. Of several tested offsets, this value gave the best result on a textured
# sphere.
_MIP_BIAS = -1.0
# Sample points of corners are moved towards the centre of the face by this share of the distance. Exactly at
# the corner, filtering would include texels of neighbouring charts.
_INWARDS = 0.25


def with_vertex_uvs(mesh: Mesh) -> Mesh:
    """Return `mesh` with one UV and one normal per vertex. Faces and vertices are grouped by texture.

    A vertex is split if its corners have different textures, coordinates or normals. The last two are
    compared bit by bit. Normals stay an array with one row per corner. A split vertex keeps its index for the
    first copy. The other copies are appended to the vertices with the same texture. Faces keep their order
    within a group.
    """
    if mesh.corner_uvs is None and mesh.face_textures is None and mesh.corner_normals is None:
        return mesh
    if mesh.face_textures is None:
        order = np.arange(len(mesh.faces))
        textures = np.zeros(len(mesh.faces), np.int64)
    else:
        order = np.argsort(mesh.face_textures, kind="stable")
        textures = mesh.face_textures[order].astype(np.int64)
    corners = mesh.faces[order].reshape(-1)
    # Collect values (C, K), the UVs and normals. Corners of a new vertex have equal values.
    values: list[NDArray[np.float32]] = []
    if mesh.corner_uvs is not None:
        values.append(mesh.corner_uvs.reshape(-1, 3, 2)[order].reshape(-1, 2))
    elif mesh.vertex_uvs is not None:
        values.append(mesh.vertex_uvs[corners])
    has_uvs = bool(values)
    if mesh.corner_normals is not None:
        values.append(mesh.corner_normals.reshape(-1, 3, 3)[order].reshape(-1, 3))
    vertices, rows, numbers = _split_vertices(
        corners, np.repeat(textures, 3), np.concatenate(values, axis=1), len(mesh.vertices)
    )
    mesh = mesh.select(vertices, order, numbers.reshape(-1, 3))
    uvs = np.ascontiguousarray(rows[:, :2]) if has_uvs else None
    return replace(mesh, vertex_uvs=uvs, corner_uvs=None)


def _split_vertices(
    corners: NDArray[np.int64], textures: NDArray[np.int64], values: NDArray[np.float32], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """Return the old vertex (N,) and the values (N, K) of each new vertex.

    Also return the new vertex of each corner. The corners are grouped by texture. The corners have the vertex
    indices `corners` (C,), the texture indices `textures` (C,) and the `values` (C, K). The argument `count`
    is the number of old vertices. Unused vertices are kept.
    """
    # Corners with the same vertex, texture and values (compared bit by bit) share a new vertex. Sort the
    # corners into groups. `first` (N,) is the earliest corner of each group, and `numbers` (C,) is the group
    # of each corner.
    values = np.ascontiguousarray(values)
    bits: NDArray[Any]
    if values.shape[1] == 2:
        bits = values.view(np.uint64)[:, 0]
    else:
        bits = np.unique(values.view(np.uint32), axis=0, return_inverse=True)[1].reshape(-1)
    by = np.lexsort((bits, textures, corners))
    differs = np.ones(len(by), bool)
    same = [keys[by[1:]] == keys[by[:-1]] for keys in (bits, textures, corners)]
    differs[1:] = ~np.logical_and.reduce(same)
    first = by[differs]
    numbers = np.zeros(len(by), np.int64)
    numbers[by] = np.cumsum(differs) - 1

    # An old vertex that is split has several groups. The new vertex of the group with the earliest corner
    # replaces the old vertex.
    vertices = corners[first]
    begins = np.flatnonzero(np.diff(vertices, prepend=-1))
    stays = np.zeros(len(first), bool)
    earliest = np.minimum.reduceat(first, begins)
    stays[np.isin(first, earliest, assume_unique=True)] = True
    used = np.zeros(count, bool)
    used[vertices] = True
    unused = np.flatnonzero(~used)

    # Append the unused vertices. Sort by texture. Within each texture, vertices that keep their index come
    # before copies.
    vertices = np.concatenate((vertices, unused))
    stays = np.concatenate((stays, np.ones(len(unused), bool)))
    place = np.where(stays, vertices, np.concatenate((first, unused)))
    group = np.concatenate((textures[first], np.full(len(unused), textures.min(initial=0))))
    rank = np.lexsort((place, ~stays, group))
    moved = np.zeros(len(rank), np.int64)
    moved[rank] = np.arange(len(rank))
    rows = np.concatenate((values[first], np.zeros((len(unused), values.shape[1]), np.float32)))
    return vertices[rank], rows[rank], moved[numbers]


def without_textures(mesh: Mesh) -> Mesh:
    """Return `mesh` without textures and texture coordinates."""
    bare = Sampler()
    return replace(mesh, vertex_uvs=None, corner_uvs=None, textures=(), face_textures=None, sampler=bare)


def with_sampled_colors(mesh: Mesh) -> Mesh:
    """Return `mesh` without textures. The vertex colours are sampled from the textures.

    The colour of a vertex is the average over its corners, in linear light, weighted by face area. The colour
    of a corner is the texture colour, filtered to the size of the face. Alpha is multiplied with the vertex
    colour, or with the face colour if there are no vertex colours. Alpha is kept if the sampler has an alpha
    cut-off.
    """
    if not mesh.textures:
        return without_textures(mesh)
    corners = mesh.faces.reshape(-1)
    uvs = mesh.vertex_uvs[corners] if mesh.corner_uvs is None else mesh.corner_uvs  # type: ignore[index]

    # Compute `sampled` (3F, 4), the linear colour and alpha at each corner.
    sampled = _sample_corners(mesh, uvs.reshape(-1, 3, 2).astype(np.float64))
    if mesh.vertex_colors is None and mesh.face_colors is not None:
        sampled *= np.repeat(linear_light(with_alpha(mesh.face_colors)), 3, axis=0)
    points = mesh.vertices[mesh.faces].astype(np.float64)
    # Weight (3F,): the face area. Scale the coordinates first, so that products do not overflow.
    points /= np.abs(points).max(initial=np.finfo(np.float64).tiny, where=np.isfinite(points))
    area = np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1)
    weight = np.repeat(area + np.finfo(np.float32).tiny, 3)
    # Average the corners of each vertex. Unused vertices are white.
    total = np.bincount(corners, weight, len(mesh.vertices))
    light = np.ones((len(mesh.vertices), 4))
    used = total > 0
    for channel in range(4):
        light[used, channel] = np.bincount(corners, weight * sampled[:, channel], len(mesh.vertices))[used]
    light[used] /= total[used, None]
    if mesh.vertex_colors is not None:
        light *= linear_light(with_alpha(mesh.vertex_colors))
    light[:, :3] = linear_to_srgb(light[:, :3])
    width = 3 if mesh.sampler.alpha_cutoff is None else 4
    colors = np.rint(light[:, :width] * 255).astype(np.uint8)
    return replace(without_textures(mesh), vertex_colors=colors, face_colors=None)


def _sample_corners(mesh: Mesh, uvs: NDArray[np.float64]) -> NDArray[np.float32]:
    """Sample the textures at corners with the UVs `uvs` (F, 3, 2). Return linear light and alpha (3F, 4)."""
    light = np.zeros((len(uvs), 3, 4), np.float32)
    smooth = replace(mesh.sampler, filter="linear", mipmaps=True)
    inside = uvs + _INWARDS * (uvs.mean(axis=1, keepdims=True) - uvs)
    for number, image in enumerate(mesh.textures):
        shows = slice(None) if mesh.face_textures is None else mesh.face_textures == number
        # Choose the mip level from the area of each face in texels.
        size = np.array(image.shape[1::-1])
        first, second = (((uvs[shows, k] - uvs[shows, 0]) * size).T for k in (1, 2))
        texels = np.abs(first[0] * second[1] - first[1] * second[0]) / 2
        lod = 0.5 * np.log2(np.maximum(texels, 1)) + _MIP_BIAS
        colors = sample(mip_levels(image), inside[shows].reshape(-1, 2), smooth, np.repeat(lod, 3))
        light[shows] = colors.reshape(-1, 3, 4)
    return light.reshape(-1, 4)
