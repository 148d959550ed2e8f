"""Writes meshes as GLB files."""

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
from msb.meshes.image_files import encode_image
from msb.meshes.mesh import Mesh
from msb.meshes.normals import vertex_normals
from msb.meshes.placement import KEY
from msb.meshes.writing import as_local

_UNLIT = "KHR_materials_unlit"
_WEBP = "EXT_texture_webp"
_COMPONENTS = {kind[1:]: number for number, kind in COMPONENTS.items()}
# Target values of glTF buffer views.
VERTICES, INDICES = 34962, 34963
# A mesh with at least this number of vertices has uint32 indices. In uint16 indices, the value 65535 would
# restart a strip.
_MAX_SHORT = 1 << 16
_FILTERS = {
    ("linear", True): 9987,
    ("linear", False): 9729,
    ("nearest", True): 9984,
    ("nearest", False): 9728,
}
_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}


@dataclass(frozen=True)
class Primitive:
    """A primitive: its vertex attributes (V, K) by name, its faces (F, 3), and the index of its texture.

    Without faces, every three vertices are a face.
    """

    attributes: dict[str, NDArray[Any]]
    faces: NDArray[np.int64] | None
    texture: int | None


@dataclass
class GlbBuilder:
    """A GLB file under construction: its JSON, and the parts of its binary chunk, padded to four bytes."""

    root: dict[str, Any]
    binary: list[bytes | memoryview] = field(default_factory=list)
    size: int = 0

    def add(self, key: str, entry: dict[str, Any]) -> int:
        """Append an object to the array `key` of the JSON. Return the index of the object."""
        self.root.setdefault(key, []).append(entry)
        return len(self.root[key]) - 1

    def require(self, extension: str) -> None:
        """Mark an extension as required for reading the file."""
        for key in ("extensionsUsed", "extensionsRequired"):
            if extension not in self.root.setdefault(key, []):
                self.root[key].append(extension)

    def put(self, data: bytes | NDArray[Any]) -> dict[str, int]:
        """Append bytes to the binary chunk. Return the buffer view for these bytes."""
        content = data if isinstance(data, bytes) else np.ascontiguousarray(data).data.cast("B")
        start, self.size = self.size, self.size + len(content)
        self.binary.append(content)
        if gap := -self.size % 4:
            self.binary.append(bytes(gap))
            self.size += gap
        return {"buffer": 0, "byteOffset": start, "byteLength": len(content)}

    def rows(self, name: str, rows: NDArray[Any]) -> int:
        """Append the attribute `name` (V, K) of the vertices. Return the index of its buffer view."""
        return self.add("bufferViews", self.put(rows) | {"target": VERTICES})

    def indices(self, faces: NDArray[Any]) -> int:
        """Append faces (F, 3), uint16 or uint32. Return the index of their buffer view."""
        return self.add("bufferViews", self.put(faces) | {"target": INDICES})


def write(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write a two-sided mesh with one primitive per texture, unlit by default. Face colours are not written.

    Positions and texture coordinates are float32, because some programs do not scale normalized integers. An
    origin of the positions becomes the translation of the node. Colours are linear light as uint8 or uint16.
    If the style requests sRGB, colours are written as stored.
    """
    if not len(mesh.faces):
        raise OutputError("OUTPUT_FORMAT_LIMIT", "GLB cannot store a mesh without faces; use PLY")
    mesh = with_vertex_uvs(mesh)
    if style.web is not None:
        from msb.meshes.glb_web import write_web

        write_web(mesh, stream, style)
        return
    builder = GlbBuilder(start_root(mesh, style))
    positions, origin = as_local(mesh.vertices, "GLB")
    if any(origin):
        builder.root["nodes"][0]["translation"] = list(origin)
    attributes: dict[str, NDArray[Any]] = {"POSITION": positions}
    if mesh.vertex_colors is not None:
        attributes["COLOR_0"] = _encode_colors(mesh.vertex_colors, style)
    if mesh.vertex_uvs is not None:
        attributes["TEXCOORD_0"] = mesh.vertex_uvs
    if mesh.corner_normals is not None:
        attributes["NORMAL"] = vertex_normals(mesh)
    add_mesh(builder, list(split(mesh, attributes)), mesh, style)
    finish(builder, stream)


def start_root(mesh: Mesh, style: Style) -> dict[str, Any]:
    """Return the JSON of a new file.

    The file contains a scene with a node for one mesh, which is added later.
    """
    asset: dict[str, Any] = {"version": "2.0", "generator": "MeshSplatBench"}
    extras = dict(style.extras or {})
    if mesh.placement is not None:
        extras[KEY] = mesh.placement.to_json()
    if style.color == "srgb" and mesh.vertex_colors is not None:
        extras["color_space"] = "srgb"
    asset |= {"extras": extras} if extras else {}
    return {
        "asset": asset,
        **({} if style.is_lit else {"extensionsUsed": [_UNLIT]}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
    }


def _encode_colors(colors: NDArray[Any], style: Style) -> NDArray[Any]:
    """Return colours (V, 3 | 4) in their stored form.

    Integer colours get an alpha channel, which aligns rows to four bytes.
    """
    if style.color != "srgb":
        colors = linear_colors(colors)
    return with_alpha(colors) if colors.dtype.kind == "u" else colors


def split(mesh: Mesh, attributes: dict[str, NDArray[Any]]) -> Iterator[Primitive]:
    """Yield one primitive per texture.

    The argument `attributes` (V, K) contains the attributes of all vertices. Faces and vertices of `mesh`
    must be grouped by texture, as `with_vertex_uvs` returns them.
    """
    if mesh.face_textures is None:
        yield Primitive(attributes, mesh.faces, 0 if mesh.textures else None)
        return
    used, starts = np.unique(mesh.face_textures, return_index=True)
    faces = np.split(mesh.faces, starts[1:])
    # The vertices of primitive i are the rows first[i] to first[i + 1] - 1.
    first = [0, *(int(group.min()) for group in faces[1:]), len(mesh.vertices)]
    for number, texture in enumerate(used.tolist()):
        selected = slice(first[number], first[number + 1])
        rows = {name: values[selected] for name, values in attributes.items()}
        yield Primitive(rows, faces[number] - first[number], texture)


def add_mesh(builder: GlbBuilder, parts: list[Primitive], mesh: Mesh, style: Style) -> None:
    """Add the primitives `parts` of `mesh` and their materials to the file."""
    primitives: list[dict[str, Any]] = []
    for number, part in enumerate(parts):
        entry = {}
        for name, rows in part.attributes.items():
            rows = rows.astype(rows.dtype.newbyteorder("<"), copy=False)
            accessor = _describe_array(rows, builder.rows(name, rows))
            if name == "POSITION":
                accessor.pop("normalized", None)
                accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
            entry[name] = builder.add("accessors", accessor)
        primitives.append({"attributes": entry, "material": number})
        if part.faces is not None:
            faces = part.faces.astype("<u2" if len(part.attributes["POSITION"]) < _MAX_SHORT else "<u4")
            indices = builder.add("accessors", _describe_array(faces.reshape(-1), builder.indices(faces)))
            primitives[-1]["indices"] = indices
        _add_material(builder, part.texture, mesh, style)
    builder.root["meshes"] = [{"primitives": primitives}]


def _describe_array(rows: NDArray[Any], view: int) -> dict[str, Any]:
    """Return the accessor of an array (N, K) or (N,) that covers the whole buffer view `view`."""
    accessor: dict[str, Any] = {"bufferView": view, "componentType": _COMPONENTS[rows.dtype.str[1:]]}
    accessor |= {"count": len(rows), "type": "SCALAR" if rows.ndim == 1 else f"VEC{rows.shape[1]}"}
    return accessor | ({"normalized": True} if rows.ndim > 1 and rows.dtype.kind == "u" else {})


def _add_material(builder: GlbBuilder, texture: int | None, mesh: Mesh, style: Style) -> None:
    """Add the two-sided material of a primitive. Programs that light this material show a rough surface."""
    surface: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 1}
    material: dict[str, Any] = {"pbrMetallicRoughness": surface}
    material |= {"doubleSided": True} if style.is_lit else {"extensions": {_UNLIT: {}}, "doubleSided": True}
    if texture is not None:
        surface["baseColorTexture"] = {"index": _add_texture(builder, mesh, texture, style)}
        if mesh.sampler.alpha_cutoff is not None:
            material |= {"alphaMode": "MASK", "alphaCutoff": mesh.sampler.alpha_cutoff}
    builder.add("materials", material)


def _add_texture(builder: GlbBuilder, mesh: Mesh, number: int, style: Style) -> int:
    """Add texture `number` of `mesh` with its image and sampler. Return its index in the file."""
    if "samplers" not in builder.root:
        builder.add("samplers", _describe_sampler(mesh.sampler))
    content, kind = encode_image(mesh.textures[number], style.texture, mesh.sampler)
    view = builder.add("bufferViews", builder.put(content))
    image = builder.add("images", {"bufferView": view, "mimeType": f"image/{kind}"})
    if kind != "webp":
        return builder.add("textures", {"sampler": 0, "source": image})
    builder.require(_WEBP)
    return builder.add("textures", {"sampler": 0, "extensions": {_WEBP: {"source": image}}})


def _describe_sampler(sampler: Sampler) -> dict[str, int]:
    """Return the JSON of a sampler."""
    return {
        "magFilter": _FILTERS[sampler.filter, False],
        "minFilter": _FILTERS[sampler.filter, sampler.mipmaps],
        "wrapS": _WRAPS[sampler.wrap_u],
        "wrapT": _WRAPS[sampler.wrap_v],
    }


def finish(builder: GlbBuilder, stream: BinaryIO) -> None:
    """Write the file: the header, the JSON chunk and the binary chunk."""
    builder.root["buffers"] = [{"byteLength": builder.size}, *builder.root.get("buffers", [])]
    text = json.dumps(builder.root, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = HEADER.size + CHUNK.size + len(text) + CHUNK.size + builder.size
    if total >= 2**32:
        raise OutputError(
            "OUTPUT_FORMAT_LIMIT",
            f"a GLB file is limited to 4 GiB, but this file would have {total} bytes; use PLY",
        )
    stream.write(HEADER.pack(b"glTF", 2, total) + CHUNK.pack(len(text), b"JSON") + text)
    stream.write(CHUNK.pack(builder.size, b"BIN\0"))
    for content in builder.binary:
        stream.write(content)
