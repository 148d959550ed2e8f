"""GLB: glTF 2.0 in one binary file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import shorten
from msb.meshes.colors import stored_colors, with_alpha
from msb.meshes.formats import Format
from msb.meshes.glb_write import write
from msb.meshes.gltf import (
    IDENTITY,
    Accessor,
    Document,
    accessor,
    open_document,
    placed_meshes,
)
from msb.meshes.mesh import Mesh
from msb.meshes.polygons import fan_triangulate

if TYPE_CHECKING:
    from msb.meshes.source import Source

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MODES = 7

_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_mesh_quantization",
    "EXT_texture_",
    "MSFT_texture_",
)
"""Prefixes of extensions that a file may require: they change no geometry, or we read what they add."""

_ATTRIBUTES = {
    "NORMAL": "normals",
    "TANGENT": "tangents",
    "TEXCOORD": "UVs",
    "COLOR": "further colours",
    "JOINTS": "a skin",
    "WEIGHTS": "a skin",
}
"""Attribute without its number -> what it is."""
_PLAIN = [1, 1, 1]
MAX_BYTES_PER_BYTE = 64
MAX_EXTRA_BYTES = 1 << 28
_PRIMITIVE_BYTES = 1 << 10
"""The memory that a file's arrays may take: 64 bytes per byte of file, and 256 MiB.

One byte of indices gives at most 24 bytes, so only nodes and primitives that share arrays reach the limit.
Each primitive counts a KiB beside its arrays, so that the limit bounds the number of steps too."""


@dataclass(frozen=True)
class _Primitive:
    """One drawable part of a mesh: V vertices and F triangles."""

    pointer: str
    mode: int
    positions: Accessor
    indices: Accessor | None
    colors: Accessor | None

    @property
    def corners(self) -> int:
        """The number of corners drawn."""
        return self.positions.count if self.indices is None else self.indices.count

    @property
    def bytes(self) -> int:
        """The most bytes that the arrays of this part can take in a `Mesh`."""
        triangles = self.corners // 3 if self.mode == _TRIANGLES else self.corners
        colors = 0 if self.colors is None else self.colors.width * 4
        return self.positions.count * (24 + colors) + triangles * 24 + _PRIMITIVE_BYTES


@dataclass(frozen=True)
class _Part:
    """A primitive's arrays: (V, 3) floats, (F, 3) vertex numbers of its own, (V, 3 | 4) colours."""

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    colors: NDArray[Any] | None


def read(source: Source) -> Mesh:
    """Read the triangles of the default scene, primitive after primitive, in ascending order of nodes.

    Vertices are float32 as long as no node moves any, else float64. Every primitive brings its own vertices;
    where only some have colours, the others are white, as the format defines. An index outside its primitive
    stays outside the whole mesh.
    """
    document = open_document(source)
    _refuse_extensions(document)
    placed = list(placed_meshes(document))
    primitives = {mesh: _primitives(document, mesh) for mesh in {mesh for mesh, _ in placed}}
    sizes = {mesh: sum(each.bytes for each in primitives[mesh]) for mesh in primitives}
    _check_total(document, sum(sizes[mesh] for mesh, _ in placed))
    if not any(primitives.values()) and document.root.get("meshes"):
        text = "the scene shows no mesh with triangles, although the file has meshes"
        raise source.error("MESH_FILE_INVALID", text)
    parts = {mesh: [_read_part(each) for each in primitives[mesh]] for mesh in primitives}
    joined = _join([_moved(part, matrix) for mesh, matrix in placed for part in parts[mesh]])
    return replace(joined, left_out=_left_out(document, [mesh for mesh, _ in placed]), up=FORMAT.up)


def _refuse_extensions(document: Document) -> None:
    """Refuse a file that requires what we do not know: its accessors may hold nothing without that."""
    for name in document.array(document.root, "extensionsRequired", ""):
        if not str(name).startswith(_HARMLESS):
            text = f"the file requires extension {shorten(str(name))}, which is not read; export without it"
            raise document.error("MESH_FILE_UNSUPPORTED", "/extensionsRequired", text)


def _primitives(document: Document, mesh: int) -> list[_Primitive]:
    """Return the parts of mesh number `mesh` that have triangles."""
    owner, pointer = document.entry("meshes", mesh)
    primitives = []
    for number, entry in enumerate(document.array(owner, "primitives", pointer)):
        where = f"{pointer}/primitives/{number}"
        if not isinstance(entry, dict):
            raise document.error("MESH_FILE_INVALID", where, "a primitive is an object")
        if document.integer(entry, "mode", where, default=_TRIANGLES, below=_MODES) >= _TRIANGLES:
            primitives.append(_primitive(document, entry, where))
    return primitives


def _primitive(document: Document, entry: dict[str, Any], pointer: str) -> _Primitive:
    """Return the description of a primitive; its arrays are known to be there."""
    attributes = document.object(entry, "attributes", pointer)
    where = f"{pointer}/attributes"
    number = document.integer(attributes, "POSITION", where)
    packed = "KHR_draco_mesh_compression"
    only_packed = "bufferView" not in document.entry("accessors", number)[0]
    if only_packed and packed in document.object(entry, "extensions", pointer):
        text = f"its arrays exist only compressed ({packed}), which is not read; export without it"
        raise document.error("MESH_FILE_UNSUPPORTED", pointer, text)
    positions = accessor(document, number, kinds="VEC3", components="i1 u1 i2 u2 f4")
    indices = colors = None
    if "indices" in entry:
        number = document.integer(entry, "indices", pointer)
        indices = accessor(document, number, kinds="SCALAR", components="u1 u2 u4")
    if "COLOR_0" in attributes:
        number = document.integer(attributes, "COLOR_0", where)
        colors = accessor(document, number, kinds="VEC3 VEC4", components="u1 u2 f4")
        if colors.count != positions.count:
            text = f"there are {colors.count} colours for {positions.count} vertices"
            raise document.error("MESH_FILE_INVALID", f"{where}/COLOR_0", text)
    mode = document.integer(entry, "mode", pointer, default=_TRIANGLES)
    made = _Primitive(pointer, mode, positions, indices, colors)
    if mode == _TRIANGLES and made.corners % 3:
        text = f"{made.corners} corners are no whole number of triangles"
        raise document.error("MESH_FILE_INVALID", pointer, text)
    return made


def _check_total(document: Document, total: int) -> None:
    """Refuse arrays of `total` bytes if the file is too small for so many."""
    limit = MAX_BYTES_PER_BYTE * len(document.source.data) + MAX_EXTRA_BYTES
    if total > limit:
        text = (
            f"the arrays of its nodes would take {total} bytes; {limit} is the limit for a file of this size"
        )
        raise document.source.error("MESH_FILE_TOO_LARGE", text)


def _read_part(primitive: _Primitive) -> _Part:
    """Return the arrays of `primitive`."""
    vertices = primitive.positions.read()
    if vertices.dtype.kind == "f":
        vertices = vertices.astype(np.float32)
    elif primitive.positions.normalized:
        vertices = np.maximum(vertices / np.iinfo(vertices.dtype).max, -1)
    else:
        vertices = vertices.astype(np.float64)
    if primitive.indices is None:
        corners = np.arange(primitive.positions.count)
    else:
        corners = primitive.indices.read()[:, 0].astype(np.int64)
    colors = None if primitive.colors is None else stored_colors(primitive.colors.read())
    return _Part(vertices, _triangles(corners, primitive.mode), colors)


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (F, 3) drawn with `corners` (C,)."""
    if mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == _FAN:
        return fan_triangulate(corners, np.array([len(corners)]))[0]
    first = np.arange(max(len(corners) - 2, 0))
    odd = first % 2
    return np.stack((corners[first], corners[first + 1 + odd], corners[first + 2 - odd]), axis=1)


def _moved(part: _Part, matrix: NDArray[np.float64]) -> _Part:
    """Return `part` with the transform (4, 4) applied; the identity changes nothing, not even the type."""
    if np.array_equal(matrix, IDENTITY):
        return part
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = part.vertices.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return _Part(vertices, part.faces, part.colors)


def _join(parts: list[_Part]) -> Mesh:
    """Return the mesh of all parts, one after the other."""
    if not parts:
        return Mesh(np.zeros((0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int64))
    total = sum(len(part.vertices) for part in parts)
    faces, base = [], 0
    for part in parts:
        own = len(part.vertices)
        # An index beyond its own part must not come to name a vertex of the next one.
        faces.append(np.where(part.faces < own, part.faces + base, part.faces - own + total))
        base += own
    colors = None
    if any(part.colors is not None for part in parts):
        colors = _join_colors(parts)
    return Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces), colors)


def _join_colors(parts: list[_Part]) -> NDArray[Any]:
    """Return the colours (V, 3 | 4) of all parts in the widest type and width among them."""
    given = [part.colors for part in parts if part.colors is not None]
    as_bytes = all(colors.dtype == np.uint8 for colors in given)
    wide = any(colors.shape[1] == 4 for colors in given)
    joined = []
    for part in parts:
        colors = part.colors
        if colors is None:
            colors = np.full((len(part.vertices), 3), 255, dtype=np.uint8)
        if not as_bytes and colors.dtype == np.uint8:
            colors = (colors / 255).astype(np.float32)
        joined.append(with_alpha(colors) if wide else colors)
    return np.concatenate(joined)


def _left_out(document: Document, meshes: Iterable[int]) -> tuple[str, ...]:
    """Return what is not read of the `meshes` of a scene, and of the file beside meshes.

    What is malformed here is no error: it is not read.
    """
    parts: dict[str, None] = {}
    for mesh in dict.fromkeys(meshes):
        for primitive in _objects(document.entry("meshes", mesh)[0].get("primitives")):
            for name in _keys(primitive.get("attributes")):
                word = str(name).partition("_")[0]
                if word != "POSITION" and name != "COLOR_0":
                    parts[_ATTRIBUTES.get(word, "further attributes")] = None
            if primitive.get("targets"):
                parts["morph targets"] = None
    colored = [each for each in _objects(document.root.get("materials")) if _has_color(each)]
    for title, entries in (
        ("texture", document.root.get("textures")),
        ("material colour", colored),
        ("animation", document.root.get("animations")),
    ):
        if isinstance(entries, list) and entries:
            parts[f"{len(entries)} {title}{'' if len(entries) == 1 else 's'}"] = None
    return tuple(parts)


def _has_color(material: dict[str, Any]) -> bool:
    surface = material.get("pbrMetallicRoughness")
    factor = surface.get("baseColorFactor", _PLAIN) if isinstance(surface, dict) else _PLAIN
    return isinstance(factor, list) and factor[:3] != _PLAIN


def _objects(entries: Any) -> list[dict[str, Any]]:
    return [each for each in entries if isinstance(each, dict)] if isinstance(entries, list) else []


def _keys(entry: Any) -> list[Any]:
    return list(entry) if isinstance(entry, dict) else []


FORMAT = Format(
    "GLB",
    (".glb",),
    read,
    write,
    begins=re.compile(rb"glTF"),
    keeps=("vertex_colors",),
    is_single=True,
    up="+y",
)
