"""Reads textures of PLY files.

In PLY files by OpenMVS and MeshLab, comments name the images, and vertices or faces have UVs.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_TEXTURES
from msb.errors import MeshFileError
from msb.meshes.images import MAX_FILE, Decoder, describe_lost_image
from msb.meshes.linked_files import read_linked_file, resolve_linked_path
from msb.meshes.mesh import Mesh
from msb.meshes.ply_body import Body, Rows
from msb.meshes.ply_header import Element, Header
from msb.meshes.polygons import Triangulation
from msb.meshes.source import Source

# Names of properties. A vertex has texture coordinates, and a face has a list of coordinates and an image
# index.
_PAIRS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_LIST, _NUMBER = "texcoord", "texnumber"
_WHITE = np.full((1, 1, 3), 255, np.uint8)


def list_read_properties(header: Header) -> set[str]:
    """Return the names of the properties that `with_textures` reads."""
    elements = {element.name: element for element in header.elements}
    if not header.images or "vertex" not in elements or "face" not in elements:
        return set()
    if _has_list(elements["face"]):
        return {_LIST, _NUMBER}
    return {*(_find_pair(elements["vertex"]) or ()), _NUMBER}


def with_textures(
    mesh: Mesh,
    source: Source,
    images: tuple[str, ...],
    body: Body,
    rows: tuple[Rows, Rows],
    counts: NDArray[np.int64],
    cut: Triangulation,
) -> Mesh:
    """Return `mesh` with its texture coordinates and with the `images` named in the header.

    The argument `rows` contains the rows of the elements for vertices and faces. The argument `counts` (N,)
    is the number of corners of each polygon. The argument `cut` contains the triangles of the polygons. In a
    PLY file, v points upwards. A face without texture coordinates is white. Images that cannot be read become
    white and are listed in `left_out`.
    """
    vertices, faces = rows
    pair = _find_pair(vertices.element)
    numbers = _read_numbers(body, faces, len(images))
    if _has_list(faces.element):
        lengths, values = body.numbers(faces, _LIST)
        is_placed = (lengths == 2 * counts) & (counts > 0)
        if (~is_placed & (lengths > 0)).any():
            return _name_images(mesh, images, "there are not two texture coordinates for each corner")
        uvs = np.zeros((int(counts.sum()), 2))
        uvs[np.repeat(is_placed, counts)] = values.reshape(-1, 2)
        mesh = replace(mesh, corner_uvs=_turn(uvs[cut.order.reshape(-1)]))
        numbers = np.where(is_placed, numbers, len(images))
    elif pair is not None:
        uvs = np.stack([body.column(vertices, name) for name in pair], axis=1)
        mesh = replace(mesh, vertex_uvs=_turn(uvs))
    else:
        return _name_images(mesh, images, "there are no texture coordinates")
    return _with_images(mesh, source, images, numbers[cut.polygon])


def _name_images(mesh: Mesh, images: tuple[str, ...], reason: str) -> Mesh:
    """Return `mesh` with the names of unread images in `left_out`."""
    names = (describe_lost_image(name, reason) for name in images)
    return replace(mesh, left_out=(*mesh.left_out, *names))


def _has_list(faces: Element) -> bool:
    """Return whether faces have a list of texture coordinates."""
    entry = faces.find(_LIST)
    return entry is not None and entry.count_type != ""


def _find_pair(vertices: Element) -> tuple[str, str] | None:
    """Return the names of the texture coordinates of vertices, or None if there are none."""
    found = {entry.name for entry in vertices.properties if not entry.count_type}
    return next((pair for pair in _PAIRS if set(pair) <= found), None)


def _turn(uvs: NDArray[np.generic]) -> NDArray[np.float32]:
    """Return coordinates (N, 2) as float32, with v downwards."""
    with np.errstate(over="ignore"):
        stored = uvs.astype(np.float64)
        return np.column_stack((stored[:, 0], 1 - stored[:, 1])).astype(np.float32)


def _read_numbers(body: Body, faces: Rows, images: int) -> NDArray[np.int64]:
    """Return the image index (N,) of each polygon.

    An invalid image index is replaced by `images`, the number of images.
    """
    entry = faces.element.find(_NUMBER)
    if images == 1 or entry is None or entry.count_type:
        return np.zeros(len(faces.place), np.int64)
    stored = np.nan_to_num(body.column(faces, _NUMBER).astype(np.float64), nan=-1)
    return np.where((stored >= 0) & (stored < images), stored, images).astype(np.int64)


def _with_images(mesh: Mesh, source: Source, images: tuple[str, ...], numbers: NDArray[np.int64]) -> Mesh:
    """Return `mesh` with the images that its faces use.

    The argument `numbers` (F,) contains the image indices of the faces.
    """
    used, of_face = np.unique(numbers, return_inverse=True)
    if len(used) > MAX_TEXTURES:
        text = f"the file has {len(used)} textures; at most {MAX_TEXTURES} are supported"
        raise source.error("MESH_FILE_TOO_LARGE", text)
    if len(used) > 1:
        mesh = replace(mesh, face_textures=of_face.reshape(-1).astype(np.uint32))
    if not source.images:
        return mesh
    decoder, textures, lost = Decoder(), [], []
    for number in used.tolist():
        texels = _WHITE
        if number < len(images):
            name = images[number].replace("\\", "/")
            try:
                resolve_linked_path(source, name, "TextureFile")
                data = read_linked_file(source, name, "TextureFile", MAX_FILE)
                texels = decoder.decode(data, alpha=False)
            except MeshFileError as error:
                lost.append(describe_lost_image(images[number], error.message))
        textures.append(texels)
    mesh = replace(mesh, left_out=(*mesh.left_out, *lost))
    if all(texels is _WHITE for texels in textures):
        return replace(mesh, vertex_uvs=None, corner_uvs=None, face_textures=None)
    return replace(mesh, textures=tuple(textures))
