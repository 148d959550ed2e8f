"""Read the primitives of glTF meshes.

The descriptions of primitives are validated first, then their arrays are read.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.seam_keys import hash_attributes
from msb.errors import MeshFileError
from msb.meshes.colors import stored_colors
from msb.meshes.gltf import IDENTITY, Accessor, Document, parse_accessor
from msb.meshes.gltf_materials import BaseColor, read_base_color, transform_uvs
from msb.meshes.polygons import fan_triangulate

TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MODES = 7
# The estimated size of a primitive's arrays includes this number of bytes. Therefore the memory limit also
# limits the number of primitives.
_PRIMITIVE_BYTES = 1 << 10


@dataclass(frozen=True)
class Primitive:
    """A triangle primitive, and its JSON `entry`."""

    pointer: str
    entry: dict[str, Any]
    mode: int
    positions: Accessor
    indices: Accessor | None
    colors: Accessor | None
    uvs: Accessor | None
    base: BaseColor
    unread: tuple[Accessor, ...] = ()

    @property
    def corners(self) -> int:
        """The number of face corners of the primitive."""
        return self.positions.count if self.indices is None else self.indices.count

    @property
    def bytes(self) -> int:
        """Upper bound of the memory, in bytes, that the arrays of the primitive need in a `Mesh`."""
        triangles = self.corners // 3 if self.mode == TRIANGLES else self.corners
        colors = 0 if self.colors is None else self.colors.width * 4
        uvs = 0 if self.uvs is None else 8
        return self.positions.count * (28 + colors + uvs) + triangles * 24 + _PRIMITIVE_BYTES


@dataclass(frozen=True)
class PrimitiveArrays:
    """The arrays of a primitive, with V vertices and F triangles.

    Attributes
    ----------
    vertices : (V, 3) float32 or float64
    faces : (F, 3) int64
        Indices into the vertices of this primitive.
    colors : (V, 3 | 4) uint8 or float32, optional
        Vertex colours in linear light, as stored.
    most : int
        65535 if the colours were stored as uint16. Otherwise 0.
    uvs : (V, 2) float32, optional
    base : BaseColor
        The material.
    keys : (V,) uint32
        The seam keys are hashes of the attributes that the reader ignores. A triangle list cannot share
        vertices, so every vertex gets a separate key if no vertex is used twice.
    """

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    colors: NDArray[Any] | None
    most: int
    uvs: NDArray[np.float32] | None
    base: BaseColor
    keys: NDArray[np.uint32]


def parse_primitives(document: Document, mesh: int) -> list[Primitive]:
    """Return the primitives with triangles of the mesh with the index `mesh`."""
    owner, pointer = document.entry("meshes", mesh)
    primitives = []
    for number, entry in enumerate(document.array(owner, "primitives", pointer)):
        where = f"{pointer}/primitives/{number}"
        if not isinstance(entry, dict):
            raise document.error("MESH_FILE_INVALID", where, "a primitive must be an object")
        if document.integer(entry, "mode", where, default=TRIANGLES, below=_MODES) >= TRIANGLES:
            primitives.append(_parse_primitive(document, entry, where))
    return primitives


def _parse_primitive(document: Document, entry: dict[str, Any], pointer: str) -> Primitive:
    """Return the validated description of a primitive."""
    attributes = document.object(entry, "attributes", pointer)
    where = f"{pointer}/attributes"
    number = document.integer(attributes, "POSITION", where)
    unpacked = document.packed.get(pointer, {})
    mode = document.integer(entry, "mode", pointer, default=TRIANGLES)
    if unpacked:
        mode = TRIANGLES  # The Draco decoder returns strips as triangles.
    positions = parse_accessor(
        document, number, kinds="VEC3", components="i1 u1 i2 u2 f4", unpacked=unpacked.get("POSITION")
    )
    indices = None
    if "indices" in entry:
        number = document.integer(entry, "indices", pointer)
        decoded = unpacked.get("indices")
        indices = parse_accessor(document, number, kinds="SCALAR", components="u1 u2 u4", unpacked=decoded)
    # Read the UV set that the texture uses. If the UV set is missing, drop the texture.
    base = read_base_color(document, entry, pointer)
    uv_set = 0 if base.texture is None else base.texture.uv_set
    name = f"TEXCOORD_{uv_set}"
    uvs = _parse_attribute(document, attributes, where, name, positions.count, unpacked.get(name))
    if base.texture is not None and uvs is None:
        base = replace(base, texture=None, is_lost=True)
    colors = _parse_attribute(
        document, attributes, where, "COLOR_0", positions.count, unpacked.get("COLOR_0")
    )
    unread = _parse_unread(document, attributes, positions.count, base, unpacked)
    primitive = Primitive(pointer, entry, mode, positions, indices, colors, uvs, base, unread)
    if mode == TRIANGLES and primitive.corners % 3:
        text = f"the number of corners, {primitive.corners}, is not a multiple of 3"
        raise document.error("MESH_FILE_INVALID", pointer, text)
    return primitive


def _parse_attribute(
    document: Document,
    attributes: dict[str, Any],
    pointer: str,
    name: str,
    count: int,
    unpacked: NDArray[Any] | None,
) -> Accessor | None:
    """Return the colours or texture coordinates of `count` vertices, or None if they are missing."""
    if name not in attributes:
        return None
    is_color = name.startswith("COLOR")
    kinds, components = ("VEC3 VEC4", "u1 u2 f4") if is_color else ("VEC2", "i1 u1 i2 u2 f4")
    number = document.integer(attributes, name, pointer)
    values = parse_accessor(document, number, kinds=kinds, components=components, unpacked=unpacked)
    if values.count != count:
        what = "colours" if is_color else "texture coordinates"
        text = f"there are {values.count} {what} for {count} vertices"
        raise document.error("MESH_FILE_INVALID", f"{pointer}/{name}", text)
    return values


def _parse_unread(
    document: Document,
    attributes: dict[str, Any],
    count: int,
    base: BaseColor,
    unpacked: Mapping[str, NDArray[Any]],
) -> tuple[Accessor, ...]:
    """Return the attributes of `count` vertices that are only used for seam keys.

    Malformed attributes are ignored.
    """
    read = {"POSITION", "COLOR_0"}
    if base.texture is not None:
        read.add(f"TEXCOORD_{base.texture.uv_set}")
    found = []
    for name, number in sorted(attributes.items()):
        if name in read or not isinstance(number, int):
            continue
        try:
            values = parse_accessor(
                document,
                number,
                kinds="SCALAR VEC2 VEC3 VEC4",
                components="i1 u1 i2 u2 u4 f4",
                unpacked=unpacked.get(name),
            )
        except MeshFileError:
            continue
        if values.count == count:
            found.append(values)
    return tuple(found)


def _hash_unread(primitive: Primitive, corners: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Return the seam keys (V,) of a primitive. See `PrimitiveArrays`."""
    count = primitive.positions.count
    columns: list[NDArray[Any]] = [stored.read() for stored in primitive.unread]
    used = np.zeros(count, bool)
    used[corners[(corners >= 0) & (corners < count)]] = True
    if primitive.mode == TRIANGLES and len(corners) == count and used.all():
        columns = [np.arange(count)]
    # The key includes the index of the primitive, because primitives do not share vertices.
    number = int(primitive.pointer.rpartition("/")[2])
    return hash_attributes([np.full(count, number), *columns])


def read_arrays(primitive: Primitive) -> PrimitiveArrays:
    """Return the arrays of `primitive`."""
    if primitive.indices is None:
        corners = np.arange(primitive.positions.count)
    else:
        corners = primitive.indices.read()[:, 0].astype(np.int64)
    colors, most, uvs = None, 0, None
    if primitive.colors is not None:
        colors = stored_colors(primitive.colors.read())
        most = 65535 if primitive.colors.dtype.itemsize == 2 else 0
    if primitive.uvs is not None:
        uvs = read_numbers(primitive.uvs).astype(np.float32)
        if primitive.base.texture is not None:
            uvs = transform_uvs(uvs, primitive.base.texture)
    faces = _assemble_triangles(corners, primitive.mode)
    positions, keys = read_numbers(primitive.positions), _hash_unread(primitive, corners)
    return PrimitiveArrays(positions, faces, colors, most, uvs, primitive.base, keys)


def read_numbers(stored: Accessor) -> NDArray[Any]:
    """Return floats as float32, and integers as float64. Normalized integers are scaled to [-1, 1]."""
    values = stored.read()
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    if stored.normalized:
        return np.maximum(values / np.iinfo(values.dtype).max, -1)
    return values.astype(np.float64)


def _assemble_triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (F, 3) of the vertex indices `corners` (C,) in the drawing mode `mode`."""
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == _FAN:
        return fan_triangulate(corners)
    # In a triangle strip, every corner forms a triangle with the next two corners. Every second triangle of a
    # strip is reversed.
    first = np.arange(max(len(corners) - 2, 0))
    odd = first % 2
    return np.stack((corners[first], corners[first + 1 + odd], corners[first + 2 - odd]), axis=1)


def transform_arrays(part: PrimitiveArrays, matrix: NDArray[np.float64]) -> PrimitiveArrays:
    """Return `part` transformed by `matrix` (4, 4).

    The identity matrix changes nothing, not even the number type.

    A mirroring transform turns the front sides of faces inwards. If a transform mirrors the mesh, the winding
    is reversed to restore the front sides.
    """
    if np.array_equal(matrix, IDENTITY):
        return part
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = part.vertices.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        is_mirrored = matrix[:3, 0] @ np.cross(matrix[:3, 1], matrix[:3, 2]) < 0
    return replace(part, vertices=vertices, faces=part.faces[:, [0, 2, 1]] if is_mirrored else part.faces)
