"""Primitives of glTF: which there are, checked, and then their arrays."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.meshes.colors import stored_colors
from msb.meshes.gltf import IDENTITY, Accessor, Document, accessor
from msb.meshes.gltf_materials import Look, look_of, transformed
from msb.meshes.polygons import fan_triangulate

TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MODES = 7
# What each primitive counts beside its arrays, so that a limit of memory bounds the number of steps too.
_PRIMITIVE_BYTES = 1 << 10


@dataclass(frozen=True)
class Primitive:
    """One drawable part of a mesh: V vertices and F triangles."""

    pointer: str
    mode: int
    positions: Accessor
    indices: Accessor | None
    colors: Accessor | None
    uvs: Accessor | None
    look: Look

    @property
    def corners(self) -> int:
        """The number of corners drawn."""
        return self.positions.count if self.indices is None else self.indices.count

    @property
    def bytes(self) -> int:
        """The most bytes that the arrays of this part can take in a `Mesh`."""
        triangles = self.corners // 3 if self.mode == TRIANGLES else self.corners
        colors = 0 if self.colors is None else self.colors.width * 4
        uvs = 0 if self.uvs is None else 8
        return self.positions.count * (24 + colors + uvs) + triangles * 24 + _PRIMITIVE_BYTES


@dataclass(frozen=True)
class Part:
    """A primitive's arrays: (V, 3) floats, (F, 3) vertex numbers of its own, (V, 3 | 4) colours, (V, 2) UVs.

    The colours are as stored, in linear light; `most` is what 1 was stored as, 0 of floats.
    """

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    colors: NDArray[Any] | None
    most: int
    uvs: NDArray[np.float32] | None
    look: Look


def primitives_of(document: Document, mesh: int) -> list[Primitive]:
    """Return the parts of mesh number `mesh` that have triangles."""
    owner, pointer = document.entry("meshes", mesh)
    primitives = []
    for number, entry in enumerate(document.array(owner, "primitives", pointer)):
        where = f"{pointer}/primitives/{number}"
        if not isinstance(entry, dict):
            raise document.error("MESH_FILE_INVALID", where, "a primitive is an object")
        if document.integer(entry, "mode", where, default=TRIANGLES, below=_MODES) >= TRIANGLES:
            primitives.append(_primitive(document, entry, where))
    return primitives


def _primitive(document: Document, entry: dict[str, Any], pointer: str) -> Primitive:
    """Return the description of a primitive; its arrays are known to be there."""
    attributes = document.object(entry, "attributes", pointer)
    where = f"{pointer}/attributes"
    number = document.integer(attributes, "POSITION", where)
    unpacked = document.packed.get(pointer, {})
    mode = document.integer(entry, "mode", pointer, default=TRIANGLES)
    if unpacked:
        mode = TRIANGLES  # also where what was compressed was a strip
    positions = accessor(
        document, number, kinds="VEC3", components="i1 u1 i2 u2 f4", unpacked=unpacked.get("POSITION")
    )
    indices = None
    if "indices" in entry:
        number = document.integer(entry, "indices", pointer)
        there = unpacked.get("indices")
        indices = accessor(document, number, kinds="SCALAR", components="u1 u2 u4", unpacked=there)
    look = look_of(document, entry, pointer)
    uv_set = 0 if look.shown is None else look.shown.uv_set
    name = f"TEXCOORD_{uv_set}"
    uvs = _attribute(document, attributes, where, name, positions.count, unpacked.get(name))
    if look.shown is not None and uvs is None:
        look = replace(look, shown=None, is_lost=True)
    colors = _attribute(document, attributes, where, "COLOR_0", positions.count, unpacked.get("COLOR_0"))
    made = Primitive(pointer, mode, positions, indices, colors, uvs, look)
    if mode == TRIANGLES and made.corners % 3:
        text = f"{made.corners} corners are no whole number of triangles"
        raise document.error("MESH_FILE_INVALID", pointer, text)
    return made


def _attribute(
    document: Document,
    attributes: dict[str, Any],
    pointer: str,
    name: str,
    count: int,
    unpacked: NDArray[Any] | None,
) -> Accessor | None:
    """Return the colours or texture coordinates of `count` vertices, None if there are none."""
    if name not in attributes:
        return None
    is_color = name.startswith("COLOR")
    kinds, components = ("VEC3 VEC4", "u1 u2 f4") if is_color else ("VEC2", "i1 u1 i2 u2 f4")
    number = document.integer(attributes, name, pointer)
    found = accessor(document, number, kinds=kinds, components=components, unpacked=unpacked)
    if found.count != count:
        what = "colours" if is_color else "texture coordinates"
        text = f"there are {found.count} {what} for {count} vertices"
        raise document.error("MESH_FILE_INVALID", f"{pointer}/{name}", text)
    return found


def read_part(primitive: Primitive) -> Part:
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
        uvs = _numbers(primitive.uvs).astype(np.float32)
        if primitive.look.shown is not None:
            uvs = transformed(uvs, primitive.look.shown)
    faces = _triangles(corners, primitive.mode)
    return Part(_numbers(primitive.positions), faces, colors, most, uvs, primitive.look)


def _numbers(stored: Accessor) -> NDArray[Any]:
    """Return floats as float32, and integers as the float64 they stand for."""
    values = stored.read()
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    if stored.normalized:
        return np.maximum(values / np.iinfo(values.dtype).max, -1)
    return values.astype(np.float64)


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (F, 3) drawn with `corners` (C,)."""
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == _FAN:
        return fan_triangulate(corners, np.array([len(corners)]))[0]
    first = np.arange(max(len(corners) - 2, 0))
    odd = first % 2
    return np.stack((corners[first], corners[first + 1 + odd], corners[first + 2 - odd]), axis=1)


def moved(part: Part, matrix: NDArray[np.float64]) -> Part:
    """Return `part` with the transform (4, 4) applied; the identity changes nothing, not even the type.

    A mirrored part has its front where its corners go clockwise, so these are turned round.
    """
    if np.array_equal(matrix, IDENTITY):
        return part
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = part.vertices.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        is_mirrored = matrix[:3, 0] @ np.cross(matrix[:3, 1], matrix[:3, 2]) < 0
    return replace(part, vertices=vertices, faces=part.faces[:, [0, 2, 1]] if is_mirrored else part.faces)
