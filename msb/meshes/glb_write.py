"""Meshes written as GLB."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.errors import OutputError
from msb.meshes.charts import with_vertex_uvs
from msb.meshes.colors import linear_colors, with_alpha
from msb.meshes.gltf import CHUNK, HEADER
from msb.meshes.image_files import packed
from msb.meshes.writing import as_float32

if TYPE_CHECKING:
    from msb.asset.texture import Sampler
    from msb.meshes.formats import Style
    from msb.meshes.mesh import Mesh

_UNLIT = "KHR_materials_unlit"
_WEBP = "EXT_texture_webp"
_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_VERTICES, _INDICES = 34962, 34963
_MOST_SHORT = 1 << 16
"""Vertices that uint16 can number: the last number is no vertex, but restarts strips."""
_FILTERS = {
    ("linear", True): 9987,
    ("linear", False): 9729,
    ("nearest", True): 9984,
    ("nearest", False): 9728,
}
_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}


@dataclass(frozen=True)
class Part:
    """A primitive: the vertices `first` to `last` of a mesh, its faces (F, 3) of these, and their texture."""

    first: int
    last: int
    faces: NDArray[np.int64]
    texture: int | None


@dataclass
class Parts:
    """The JSON of a file, and the parts of its binary chunk, each a multiple of four bytes."""

    root: dict[str, Any]
    binary: list[bytes | memoryview] = field(default_factory=list)
    size: int = 0

    def add(self, key: str, entry: dict[str, Any]) -> int:
        """Append an object to the array `key` of the JSON; return its number."""
        self.root.setdefault(key, []).append(entry)
        return len(self.root[key]) - 1

    def require(self, extension: str) -> None:
        """Say that nobody can open the file who does not know the extension."""
        for key in ("extensionsUsed", "extensionsRequired"):
            if extension not in self.root.setdefault(key, []):
                self.root[key].append(extension)

    def put(self, data: bytes | NDArray[Any]) -> dict[str, int]:
        """Append bytes; return where they lie."""
        content = data if isinstance(data, bytes) else np.ascontiguousarray(data).data.cast("B")
        start, self.size = self.size, self.size + len(content)
        self.binary.append(content)
        if gap := -self.size % 4:
            self.binary.append(bytes(gap))
            self.size += gap
        return {"buffer": 0, "byteOffset": start, "byteLength": len(content)}

    def rows(self, rows: NDArray[Any]) -> int:
        """Append values of vertices (V, K), whose rows take a multiple of four bytes; return their view."""
        return self.add("bufferViews", self.put(rows) | {"byteStride": rows.strides[0], "target": _VERTICES})

    def indices(self, faces: NDArray[Any]) -> int:
        """Append faces (F, 3); return their view."""
        return self.add("bufferViews", self.put(faces) | {"target": _INDICES})


def write(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write one unlit, two-sided mesh, each texture's faces in a primitive; face colours are lost.

    Positions become float32. Colours become linear light in whole numbers; as sRGB they keep their type.
    """
    if not len(mesh.faces):
        raise OutputError("OUTPUT_FORMAT_LIMIT", "GLB cannot hold a mesh without faces; use PLY")
    mesh = with_vertex_uvs(mesh)
    about: dict[str, Any] = {"version": "2.0", "generator": "MeshSplatBench"}
    if style.color == "srgb" and mesh.vertex_colors is not None:
        about["extras"] = {"color_space": "srgb"}
    parts = Parts(
        {
            "asset": about,
            "extensionsUsed": [_UNLIT],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
        }
    )
    attributes = {"POSITION": as_float32(mesh.vertices, "GLB").astype("<f4", copy=False)}
    if mesh.vertex_colors is not None:
        attributes["COLOR_0"] = _colors(mesh.vertex_colors, style)
    if mesh.vertex_uvs is not None:
        attributes["TEXCOORD_0"] = mesh.vertex_uvs.astype("<f4", copy=False)
    add_mesh(parts, mesh, attributes)
    add_materials(parts, mesh, style)
    finish(parts, stream)


def _colors(colors: NDArray[Any], style: Style) -> NDArray[Any]:
    """Return colours (V, 3 | 4) as they are stored: whole numbers with alpha, for whole words."""
    if style.color != "srgb":
        colors = linear_colors(colors)
    if colors.dtype.kind == "u":
        colors = with_alpha(colors)
    return colors.astype(colors.dtype.newbyteorder("<"), copy=False)


def add_mesh(parts: Parts, mesh: Mesh, attributes: dict[str, NDArray[Any]]) -> None:
    """Add the primitives of `mesh` with `attributes` of its vertices, name -> (V, K)."""
    primitives: list[dict[str, Any]] = []
    views = {name: parts.rows(rows) for name, rows in attributes.items()}
    for number, part in enumerate(_split(mesh)):
        entry = {}
        for name, rows in attributes.items():
            entry[name] = parts.add(
                "accessors", _accessor(views[name], rows, part, bounds=name == "POSITION")
            )
        faces = part.faces.astype("<u2" if part.last - part.first < _MOST_SHORT else "<u4")
        listed: dict[str, Any] = {
            "bufferView": parts.indices(faces),
            "componentType": _COMPONENTS[faces.dtype.str[1:]],
        }
        listed |= {"count": faces.size, "type": "SCALAR"}
        indices = parts.add("accessors", listed)
        primitives.append({"attributes": entry, "indices": indices, "material": number})
    parts.root["meshes"] = [{"primitives": primitives}]


def _split(mesh: Mesh) -> Iterator[Part]:
    """Yield the primitives of `mesh`, whose faces and vertices are grouped by texture."""
    if not mesh.textures:
        yield Part(0, len(mesh.vertices), mesh.faces, None)
        return
    if mesh.face_textures is None:
        yield Part(0, len(mesh.vertices), mesh.faces, 0)
        return
    shown, starts = np.unique(mesh.face_textures, return_index=True)
    faces = np.split(mesh.faces, starts[1:])
    first = [0, *(int(each.min()) for each in faces[1:]), len(mesh.vertices)]
    for number, texture in enumerate(shown.tolist()):
        yield Part(first[number], first[number + 1], faces[number] - first[number], texture)


def _accessor(view: int, rows: NDArray[Any], part: Part, *, bounds: bool) -> dict[str, Any]:
    """Return the description of the `rows` of `view` that a primitive has."""
    own = rows[part.first : part.last]
    made: dict[str, Any] = {"bufferView": view, "componentType": _COMPONENTS[rows.dtype.str[1:]]}
    if part.first:
        made["byteOffset"] = part.first * rows.strides[0]
    if rows.dtype.kind != "f":
        made["normalized"] = True
    made |= {"count": len(own), "type": f"VEC{rows.shape[1]}"}
    return made | ({"min": own.min(axis=0).tolist(), "max": own.max(axis=0).tolist()} if bounds else {})


def add_materials(parts: Parts, mesh: Mesh, style: Style) -> None:
    """Add the materials of primitives: unlit, two-sided, textured; as dull as can be where they are lit."""
    for part in _split(mesh):
        surface: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 1}
        material: dict[str, Any] = {"pbrMetallicRoughness": surface}
        material |= {"extensions": {_UNLIT: {}}, "doubleSided": True}
        if part.texture is not None:
            surface["baseColorTexture"] = {"index": _add_texture(parts, mesh, part.texture, style)}
            if mesh.sampler.alpha_cutoff is not None:
                material |= {"alphaMode": "MASK", "alphaCutoff": mesh.sampler.alpha_cutoff}
        parts.add("materials", material)


def _add_texture(parts: Parts, mesh: Mesh, number: int, style: Style) -> int:
    """Add a texture with its image and sampler; return its number."""
    if "samplers" not in parts.root:
        parts.add("samplers", _sampler(mesh.sampler))
    content, kind = packed(mesh.textures[number], style.texture, mesh.sampler)
    view = parts.add("bufferViews", parts.put(content))
    image = parts.add("images", {"bufferView": view, "mimeType": f"image/{kind}"})
    if kind != "webp":
        return parts.add("textures", {"sampler": 0, "source": image})
    parts.require(_WEBP)
    return parts.add("textures", {"sampler": 0, "extensions": {_WEBP: {"source": image}}})


def _sampler(sampler: Sampler) -> dict[str, int]:
    return {
        "magFilter": _FILTERS[sampler.filter, False],
        "minFilter": _FILTERS[sampler.filter, sampler.mipmaps],
        "wrapS": _WRAPS[sampler.wrap_u],
        "wrapT": _WRAPS[sampler.wrap_v],
    }


def finish(parts: Parts, stream: BinaryIO) -> None:
    """Write the file."""
    parts.root.setdefault("buffers", []).insert(0, {"byteLength": parts.size})
    text = json.dumps(parts.root, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = HEADER.size + CHUNK.size + len(text) + CHUNK.size + parts.size
    if total >= 2**32:
        raise OutputError(
            "OUTPUT_FORMAT_LIMIT", f"a GLB has at most 4 GiB, this one would have {total} bytes"
        )
    stream.write(HEADER.pack(b"glTF", 2, total) + CHUNK.pack(len(text), b"JSON") + text)
    stream.write(CHUNK.pack(parts.size, b"BIN\0"))
    for content in parts.binary:
        stream.write(content)
