"""Textures as colours of vertices, for formats that have none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler, linear_to_srgb, mip_levels, sample, srgb_to_linear
from msb.meshes.colors import with_alpha
from msb.meshes.mesh import Mesh

_BLUR = -1.0
"""Levels of mip maps between the size of a face and what its corners see, which was best on a sphere."""
_INWARDS = 0.25
"""How far towards the middle of its face a corner's sample lies: beyond a chart's border is another chart."""


def without_textures(mesh: Mesh) -> Mesh:
    """Return `mesh` without textures and their coordinates."""
    bare = Sampler()
    return replace(mesh, vertex_uvs=None, corner_uvs=None, textures=(), face_textures=None, sampler=bare)


def with_sampled_colors(mesh: Mesh) -> Mesh:
    """Return `mesh` with what its textures show at vertices, times its own colours, in place of textures.

    A vertex gets the mean, in linear light and by the area of faces, of what its corners see: the texture
    blurred to the size of the face, times the face's colour where vertices have none. Alpha stays where the
    sampler looks at it.
    """
    if not mesh.textures:
        return without_textures(mesh)
    corners = mesh.faces.reshape(-1)
    uvs = mesh.vertex_uvs[corners] if mesh.corner_uvs is None else mesh.corner_uvs  # type: ignore[index]
    seen = _seen(mesh, uvs.reshape(-1, 3, 2).astype(np.float64))
    if mesh.vertex_colors is None and mesh.face_colors is not None:
        seen *= np.repeat(_light(mesh.face_colors), 3, axis=0)
    points = mesh.vertices[mesh.faces].astype(np.float64)
    # Or products may be infinite.
    points /= np.abs(points).max(initial=np.finfo(np.float64).tiny, where=np.isfinite(points))
    area = np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1)
    weight = np.repeat(area + np.finfo(np.float32).tiny, 3)
    total = np.bincount(corners, weight, len(mesh.vertices))
    light = np.ones((len(mesh.vertices), 4))
    used = total > 0
    for channel in range(4):
        light[used, channel] = np.bincount(corners, weight * seen[:, channel], len(mesh.vertices))[used]
    light[used] /= total[used, None]
    if mesh.vertex_colors is not None:
        light *= _light(mesh.vertex_colors)
    light[:, :3] = linear_to_srgb(light[:, :3])
    width = 3 if mesh.sampler.alpha_cutoff is None else 4
    colors = np.rint(light[:, :width] * 255).astype(np.uint8)
    return replace(without_textures(mesh), vertex_colors=colors, face_colors=None)


def _light(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return colours (N, 3 | 4) in sRGB as linear light and alpha (N, 4)."""
    own = with_alpha(colors)
    own = own / np.float32(255) if own.dtype == np.uint8 else own
    return np.concatenate((srgb_to_linear(own[:, :3]), own[:, 3:]), axis=1)


def _seen(mesh: Mesh, uvs: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return linear light and alpha (3F, 4) at the corners, whose texture coordinates are (F, 3, 2)."""
    seen = np.zeros((len(uvs), 3, 4), np.float32)
    smooth = replace(mesh.sampler, filter="linear", mipmaps=True)
    inside = uvs + _INWARDS * (uvs.mean(axis=1, keepdims=True) - uvs)
    for number, image in enumerate(mesh.textures):
        shows = slice(None) if mesh.face_textures is None else mesh.face_textures == number
        size = np.array(image.shape[1::-1])
        first, second = (((uvs[shows, k] - uvs[shows, 0]) * size).T for k in (1, 2))
        texels = np.abs(first[0] * second[1] - first[1] * second[0]) / 2
        lod = 0.5 * np.log2(np.maximum(texels, 1)) + _BLUR
        own = sample(mip_levels(image), inside[shows].reshape(-1, 2), smooth, np.repeat(lod, 3))
        seen[shows] = own.reshape(-1, 3, 4)
    return seen.reshape(-1, 4)
