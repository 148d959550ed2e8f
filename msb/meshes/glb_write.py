"""Meshes written as GLB."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.errors import OutputError
from msb.meshes.charts import with_vertex_uvs
from msb.meshes.colors import linear_colors, with_alpha
from msb.meshes.formats import Style
from msb.meshes.gltf import CHUNK, COMPONENTS, HEADER
from msb.meshes.image_files import packed
from msb.meshes.mesh import Mesh
from msb.meshes.writing import as_float32

_UNLIT = "KHR_materials_unlit"
_WEBP = "EXT_texture_webp"
_COMPONENTS = {kind[1:]: number for number, kind in COMPONENTS.items()}
VERTICES, INDICES = 34962, 34963
# Vertices that uint16 can number: the last number is no vertex, but restarts strips.
_MOST_SHORT = 1 << 16
# Texels that a texture coordinate may not be off by.
_SEEN = 1 / 8
_FILTERS = {
    ("linear", True): 9987,
    ("linear", False): 9729,
    ("nearest", True): 9984,
    ("nearest", False): 9728,
}
_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}


@dataclass(frozen=True)
class Part:
    """A primitive: attributes of its vertices, name -> (V, K), its faces (F, 3), and their texture.

    Without faces each three vertices are one.
    """

    attributes: dict[str, NDArray[Any]]
    faces: NDArray[np.int64] | None
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

    def rows(self, name: str, rows: NDArray[Any]) -> int:
        """Append the attribute `name` of vertices (V, K); return its view."""
        return self.add("bufferViews", self.put(rows) | {"target": VERTICES})

    def indices(self, faces: NDArray[Any]) -> int:
        """Append faces (F, 3) of uint16 or uint32; return their view."""
        return self.add("bufferViews", self.put(faces) | {"target": INDICES})


def write(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write one unlit, two-sided mesh, each texture's faces in a primitive; face colours are lost.

    Positions become float32. Colours become linear light in whole numbers; as sRGB they keep their type.
    Texture coordinates have four bytes where these hold them, or, beside colours of eight, are enough.
    """
    if not len(mesh.faces):
        raise OutputError("OUTPUT_FORMAT_LIMIT", "GLB cannot hold a mesh without faces; use PLY")
    mesh = with_vertex_uvs(mesh)
    if style.web is not None:
        from msb.meshes.glb_web import write_web

        write_web(mesh, stream, style)
        return
    parts = Parts(root_of(mesh, style))
    attributes: dict[str, NDArray[Any]] = {"POSITION": as_float32(mesh.vertices, "GLB")}
    if mesh.vertex_colors is not None:
        attributes["COLOR_0"] = _colors(mesh.vertex_colors, style)
    if mesh.vertex_uvs is not None:
        wide = "COLOR_0" in attributes and attributes["COLOR_0"].itemsize > 1
        short = _short_uvs(mesh, only_exact=not wide)
        attributes["TEXCOORD_0"] = mesh.vertex_uvs if short is None else short
    add_mesh(parts, list(split(mesh, attributes)), mesh, style)
    finish(parts, stream)


def root_of(mesh: Mesh, style: Style) -> dict[str, Any]:
    """Return the JSON that every file has."""
    about: dict[str, Any] = {"version": "2.0", "generator": "MeshSplatBench"}
    extras = dict(style.extras or {})
    if style.color == "srgb" and mesh.vertex_colors is not None:
        extras["color_space"] = "srgb"
    about |= {"extras": extras} if extras else {}
    return {
        "asset": about,
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
    }


def _colors(colors: NDArray[Any], style: Style) -> NDArray[Any]:
    """Return colours (V, 3 | 4) as they are stored: whole numbers with alpha, for whole words."""
    if style.color != "srgb":
        colors = linear_colors(colors)
    return with_alpha(colors) if colors.dtype.kind == "u" else colors


def _short_uvs(mesh: Mesh, *, only_exact: bool) -> NDArray[np.uint16] | None:
    """Return the texture coordinates of vertices as uint16; None where that is seen, or changes them.

    It is seen where one is not in 0 to 1 or would be off by an eighth of a texel, or where two became one.
    """
    uvs = mesh.vertex_uvs
    assert uvs is not None
    if not ((uvs >= 0) & (uvs <= 1)).all():
        return None
    short = np.rint(uvs.astype(np.float64) * 65535).astype(np.uint16)
    is_exact = np.array_equal((short / 65535).astype(np.float32), uvs)
    if is_exact or only_exact:
        return short if is_exact else None
    side = max((max(image.shape[:2]) for image in mesh.textures), default=0)
    is_seen = side / 65535 / 2 >= _SEEN or len(np.unique(short, axis=0)) < len(np.unique(uvs, axis=0))
    return None if is_seen else short


def split(mesh: Mesh, attributes: dict[str, NDArray[Any]]) -> Iterator[Part]:
    """Yield the primitives of `mesh`, grouped by texture; `attributes` (V, K) are of all vertices."""
    if mesh.face_textures is None:
        yield Part(attributes, mesh.faces, 0 if mesh.textures else None)
        return
    shown, starts = np.unique(mesh.face_textures, return_index=True)
    faces = np.split(mesh.faces, starts[1:])
    first = [0, *(int(each.min()) for each in faces[1:]), len(mesh.vertices)]
    for number, texture in enumerate(shown.tolist()):
        own = slice(first[number], first[number + 1])
        rows = {name: values[own] for name, values in attributes.items()}
        yield Part(rows, faces[number] - first[number], texture)


def add_mesh(parts: Parts, split_up: list[Part], mesh: Mesh, style: Style) -> None:
    """Add the primitives of `mesh` and their materials."""
    primitives: list[dict[str, Any]] = []
    for number, part in enumerate(split_up):
        entry = {}
        for name, rows in part.attributes.items():
            rows = rows.astype(rows.dtype.newbyteorder("<"), copy=False)
            described = _described(rows, parts.rows(name, rows))
            if name == "POSITION":
                described.pop("normalized", None)
                described |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
            entry[name] = parts.add("accessors", described)
        primitives.append({"attributes": entry, "material": number})
        if part.faces is not None:
            faces = part.faces.astype("<u2" if len(part.attributes["POSITION"]) < _MOST_SHORT else "<u4")
            indices = parts.add("accessors", _described(faces.reshape(-1), parts.indices(faces)))
            primitives[-1]["indices"] = indices
        _add_material(parts, part.texture, mesh, style)
    parts.root["meshes"] = [{"primitives": primitives}]


def _described(rows: NDArray[Any], view: int) -> dict[str, Any]:
    """Return the description of an array (N, K) or (N,) that is all of `view`."""
    made: dict[str, Any] = {"bufferView": view, "componentType": _COMPONENTS[rows.dtype.str[1:]]}
    made |= {"count": len(rows), "type": "SCALAR" if rows.ndim == 1 else f"VEC{rows.shape[1]}"}
    return made | ({"normalized": True} if rows.ndim > 1 and rows.dtype.kind == "u" else {})


def _add_material(parts: Parts, texture: int | None, mesh: Mesh, style: Style) -> None:
    """Add the material of a primitive: unlit, two-sided, textured; as dull as can be where it is lit."""
    surface: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 1}
    material: dict[str, Any] = {"pbrMetallicRoughness": surface}
    material |= {"extensions": {_UNLIT: {}}, "doubleSided": True}
    if texture is not None:
        surface["baseColorTexture"] = {"index": _add_texture(parts, mesh, texture, style)}
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
    parts.root["buffers"] = [{"byteLength": parts.size}, *parts.root.get("buffers", [])]
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
