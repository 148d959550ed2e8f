"""Splits a textured mesh into groups of faces that one UsdPreviewSurface material can show.

A UsdPreviewSurface material shows an image multiplied with one colour, or a single colour, or the primvar
`displayColor`. A UsdPreviewSurface material cannot multiply an image with colours that vary between vertices.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import LINEAR
from msb.meshes.colors import linear_light
from msb.meshes.formats import Style
from msb.meshes.image_files import describe_counts, encode_images, is_single_texel
from msb.meshes.mesh import Mesh

# Largest number of materials with a uniform colour for the faces of one texture. If there are more colours,
# faces without an image use `displayColor`. Faces with an image then use their average colour.
_MAX_COLORS = 64
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class FaceGroup:
    """Faces that share one material.

    Attributes
    ----------
    faces : (n,) int32
        The indices of the faces, in ascending order.
    image : int, optional
        The index of the texture.
    color : tuple of float, optional
        The colour of the faces in linear light. For faces with an image, the colour is a factor of the image.
        If the colour is None, the faces use `displayColor`.
    is_average : bool
        Whether this uniform colour replaces colours that vary.
    """

    faces: NDArray[np.int32]
    image: int | None
    color: tuple[float, ...] | None
    is_average: bool = False


def group_faces(mesh: Mesh) -> list[FaceGroup]:
    """Return the groups of all faces of a textured mesh, in the order of its textures."""
    light, groups, textures = corner_light(mesh), [], mesh.face_textures
    if textures is None:
        textures = np.zeros(len(mesh.faces), np.uint32)
    for number, image in enumerate(mesh.textures):
        faces = np.flatnonzero(textures == number).astype(np.int32)
        if not len(faces):
            continue
        used = None if is_single_texel(image, mesh) else number
        # rows (n, 3, 3): the colours of the corners. Use one material per colour if every face has a uniform
        # colour.
        rows = light[faces]
        if (rows == rows[0, 0]).all():
            groups.append(FaceGroup(faces, used, tuple(rows[0, 0].tolist())))
            continue
        distinct, of_face = np.unique(rows[:, 0], axis=0, return_inverse=True)
        if (rows == rows[:, :1]).all() and len(distinct) <= _MAX_COLORS:
            of_face = of_face.reshape(-1)
            for color, values in enumerate(distinct.tolist()):
                groups.append(FaceGroup(faces[of_face == color], used, tuple(values)))
        elif used is None:
            groups.append(FaceGroup(faces, None, None))
        else:
            average = tuple(rows.mean(axis=(0, 1), dtype=np.float64).tolist())
            groups.append(FaceGroup(faces, number, average, is_average=True))
    return groups


def corner_light(mesh: Mesh) -> NDArray[np.float32]:
    """Return the linear colours (F, 3, 3) of the corners, multiplied with texels of plain textures."""
    light = np.ones((len(mesh.faces), 3, 3), np.float32)
    if mesh.vertex_colors is not None:
        light *= linear_light(mesh.vertex_colors)[:, :3][mesh.faces]
    elif mesh.face_colors is not None:
        light *= linear_light(mesh.face_colors)[:, None, :3]
    for number, image in enumerate(mesh.textures):
        if is_single_texel(image, mesh):
            shown = slice(None) if mesh.face_textures is None else mesh.face_textures == number
            light[shown] *= LINEAR[image[0, 0, :3]]
    return light


def encode_used_images(mesh: Mesh, style: Style) -> dict[str, bytes]:
    """Return the image files that the materials use, as a mapping from file name to content."""
    numbers = np.zeros(len(mesh.faces), np.uint32) if mesh.face_textures is None else mesh.face_textures
    has_faces = np.isin(np.arange(len(mesh.textures)), numbers)
    used = [
        number
        for number, image in enumerate(mesh.textures)
        if has_faces[number] and not is_single_texel(image, mesh)
    ]
    return encode_images(mesh, style, used)


def list_stored(mesh: Mesh) -> list[str]:
    """Return the numbers of the images and colours that a USD file of a textured mesh stores."""
    groups = group_faces(mesh)
    images = len({group.image for group in groups if group.image is not None})
    colors = len({group.color for group in groups if group.color not in (None, WHITE)})
    return describe_counts(images, colors) + ["vertex colours"] * any(group.color is None for group in groups)


def list_lost(mesh: Mesh) -> list[str]:
    """Return the names of colour data of a mesh that a USD file does not store."""
    lost = []
    if mesh.textures and any(group.is_average for group in group_faces(mesh)):
        lost.append("colours that vary over a texture (their average is stored)")
    colors = mesh.face_colors if mesh.vertex_colors is None else mesh.vertex_colors
    if colors is not None and colors.shape[1] == 4:
        opaque = 1 if colors.dtype.kind == "f" else np.iinfo(colors.dtype).max
        lost += ["opacity of colours"] if (colors[:, 3] != opaque).any() else []
    if mesh.textures and (mesh.sampler.filter != "linear" or not mesh.sampler.mipmaps):
        lost.append("texture filters")
    return lost
