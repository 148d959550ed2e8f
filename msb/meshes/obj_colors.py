"""Chooses the materials of a written OBJ file. A material has an image, or a uniform colour as Kd."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_TEXTURES, linear_to_srgb
from msb.meshes.colors import as_floats, linear_light
from msb.meshes.image_files import describe_counts, is_single_texel
from msb.meshes.mesh import Mesh

# Largest number of passes over the faces. If this number of passes is not enough, the mesh keeps its vertex
# colours, because its parts share many vertices.
_MAX_PASSES = 16


@dataclass(frozen=True)
class WrittenMaterial:
    """A material has its sRGB colour Kd in [0, 1] and the index of its texture.

    The index is None without a texture.
    """

    color: tuple[float, ...]
    texture: int | None


def choose_materials(mesh: Mesh) -> tuple[Mesh, list[WrittenMaterial], NDArray[np.int64]]:
    """Return `mesh` in the form for writing, its materials, and the index (F,) of each face's material.

    A texture of a single opaque texel becomes a colour. If all faces of such a texture have one vertex
    colour, the material gets the product of both colours. The vertex colours of these faces then become
    white. Many programs ignore vertex colours of textured meshes.
    """
    textures = np.zeros(len(mesh.faces), np.int64)
    if mesh.face_textures is not None:
        textures = mesh.face_textures.astype(np.int64)
    plain = [number for number, image in enumerate(mesh.textures) if is_single_texel(image, mesh)]
    # Find faces with a uniform vertex colour and a texture of a single texel. `texels` contains the colours
    # of these textures.
    texels = np.ones((len(mesh.textures), 3))
    for number in plain:
        texels[number] = as_floats(mesh.textures[number][0, 0, :3])
    is_uniform = np.isin(textures, plain)
    tint = np.ones((len(mesh.faces), 3), np.float32)
    if mesh.vertex_colors is not None:
        is_uniform &= _find_uniform_faces(mesh, is_uniform)
        tint[is_uniform] = as_floats(mesh.vertex_colors[mesh.faces[is_uniform, 0]])[:, :3]
    color = _multiply(texels[textures], tint)
    color[~is_uniform] = texels[textures[~is_uniform]]
    # If a file has no images, readers may ignore the material colour Kd in favour of vertex colours.
    # If no other texture is an image, the uniform textures are therefore also stored as images.
    needs_image = len(plain) == len(mesh.textures) and not is_uniform.all()
    stays = ~np.isin(textures, plain) | (~is_uniform & needs_image & (color != 1).any(axis=1))
    rows = np.column_stack((np.where(stays, textures, -1), np.where(stays[:, None], 1, color)))
    distinct, of_face = np.unique(rows, axis=0, return_inverse=True)
    if len(distinct) > MAX_TEXTURES:  # The OBJ reader limits the number of colours.
        materials = [WrittenMaterial((1.0, 1.0, 1.0), number) for number in range(len(mesh.textures))]
        return mesh, materials, textures
    materials = [
        WrittenMaterial(tuple(row[1:].tolist()), None if row[0] < 0 else int(row[0])) for row in distinct
    ]
    return _whiten(mesh, mesh.faces[is_uniform]), materials, of_face.reshape(-1)


def _find_uniform_faces(mesh: Mesh, is_plain: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (F,) of faces with uniform colour, an opaque texture of a single texel, and no vertex
    shared with other faces."""
    assert mesh.vertex_colors is not None
    colors = mesh.vertex_colors[mesh.faces]
    is_uniform: NDArray[np.bool_] = is_plain & (colors == colors[:, :1]).all(axis=(1, 2))
    if colors.shape[2] == 4:
        is_uniform &= as_floats(colors[:, 0])[:, 3] == 1
    for _ in range(_MAX_PASSES):
        is_shared = np.zeros(len(mesh.vertices), bool)
        is_shared[mesh.faces[~is_uniform]] = True
        wrong = is_uniform & is_shared[mesh.faces].any(axis=1)
        if not wrong.any():
            return is_uniform
        is_uniform &= ~wrong
    return np.zeros(len(mesh.faces), bool)


def _multiply(texels: NDArray[np.float64], tint: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the products of sRGB colours (F, 3), computed in linear light.

    Multiplication with white does not change a colour.
    """
    light = linear_light(texels.astype(np.float32)) * linear_light(tint)
    product = linear_to_srgb(light)
    product = np.where(texels == 1, tint, product)
    return np.where(tint == 1, texels, product).astype(np.float64)


def _whiten(mesh: Mesh, faces: NDArray[np.int64]) -> Mesh:
    """Return `mesh` with white vertices in `faces` (N, 3). If all vertices are white, omit the vertex
    colours."""
    if mesh.vertex_colors is None:
        return mesh
    colors = mesh.vertex_colors.copy()
    colors[faces.reshape(-1), :3] = 255 if colors.dtype == np.uint8 else 1
    used = colors[mesh.faces.reshape(-1)]
    is_white = bool((as_floats(used) == 1).all())
    return replace(mesh, vertex_colors=None if is_white else colors)


def list_stored(mesh: Mesh) -> list[str]:
    """Return the numbers of images and colours that an OBJ file of a textured mesh stores."""
    mesh, materials, _ = choose_materials(mesh)
    images = len({material.texture for material in materials} - {None})
    colors = sum(material.texture is None for material in materials)
    return describe_counts(images, colors) + ["vertex colours"] * (mesh.vertex_colors is not None)


def list_lost(mesh: Mesh) -> list[str]:
    """Return the names of mesh data that an OBJ file does not store."""
    is_cut_out = mesh.textures and mesh.sampler.alpha_cutoff is not None
    if is_cut_out and all(image.shape[2] == 3 for image in mesh.textures):
        return ["cut-outs from the alpha of vertex colours"]
    return []
