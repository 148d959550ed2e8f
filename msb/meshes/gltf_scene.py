"""glTF 2.0: read the default scene of a file as one mesh with colours and textures.

GLB (one binary file) is read and written. glTF as JSON, with embedded or linked buffers and images, is only
read.
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_TEXTURES
from msb.errors import MeshFileError, shorten
from msb.meshes.colors import as_floats, srgb_colors, with_alpha
from msb.meshes.formats import Format
from msb.meshes.glb_write import write
from msb.meshes.gltf import Document, list_placed_meshes, open_document, parse_document
from msb.meshes.gltf_materials import (
    BaseColor,
    TextureUse,
    identify_image,
    list_other_properties,
    read_image_bytes,
)
from msb.meshes.gltf_packed import DRACO, MESHOPT, unpack
from msb.meshes.gltf_parts import PrimitiveArrays, parse_primitives, read_arrays, transform_arrays
from msb.meshes.images import Decoder
from msb.meshes.mesh import Mesh
from msb.meshes.polygons import join_faces
from msb.meshes.source import Source

# Prefixes of extensions that a file may require: they do not change the geometry, or they are supported.
_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_mesh_quantization",
    DRACO,
    *MESHOPT,
    "EXT_texture_",
    "MSFT_texture_",
)

# Attribute that is not read, without its number -> its name in messages.
_ATTRIBUTES = {
    "NORMAL": "normals",
    "TANGENT": "tangents",
    "TEXCOORD": "UVs",
    "COLOR": "further colours",
    "JOINTS": "a skin",
    "WEIGHTS": "a skin",
}
# The extension for instances of a node. A file that uses but does not require it is read without instances.
_INSTANCES = "EXT_mesh_gpu_instancing"
# The white texture of faces without a texture, if other faces have one.
_PLAIN = np.full((1, 1, 3), 255, np.uint8)
_BEGINS = re.compile(rb"\s*\{")


def read_scene(document: Document) -> Mesh:
    """Return the triangles of the default scene: the primitives one after the other, in the order of nodes.

    Vertices are float32, or float64 if a node has a transform. Primitives do not share vertices. If only some
    have colours, the others are white, as the format defines. An index outside its primitive is also out of
    range in the returned mesh.
    """
    _check_extensions(document)
    placed = list(list_placed_meshes(document))
    used = list(dict.fromkeys(mesh for mesh, _ in placed))
    unpack(document, used)
    # Check all descriptions and the total size before any array is read.
    primitives = {mesh: parse_primitives(document, mesh) for mesh in used}
    sizes = {mesh: sum(primitive.bytes for primitive in primitives[mesh]) for mesh in primitives}
    document.check_total("the arrays of all nodes", sum(sizes[mesh] for mesh, _ in placed))
    if not any(primitives.values()) and document.root.get("meshes"):
        text = "the scene contains no mesh with triangles, although the file has meshes"
        raise document.source.error("MESH_FILE_INVALID", text)
    read = {mesh: [read_arrays(primitive) for primitive in primitives[mesh]] for mesh in primitives}
    parts = [transform_arrays(part, matrix) for mesh, matrix in placed for part in read[mesh]]
    if not parts:
        joined = Mesh(np.zeros((0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int64))
    else:
        joined = _join_parts(document, parts)
    colors = [part.base for part in parts]
    return replace(joined, left_out=tuple(_list_left_out(document, used, colors)), up="+y")


def _check_extensions(document: Document) -> None:
    """Reject files that require an unsupported extension: their accessors may be meaningless without it."""
    for name in document.array(document.root, "extensionsRequired", ""):
        if not str(name).startswith(_HARMLESS):
            text = f"the required extension {shorten(str(name))} is not supported; export without it"
            raise document.error("MESH_FILE_UNSUPPORTED", "/extensionsRequired", text)


def _join_parts(document: Document, parts: list[PrimitiveArrays]) -> Mesh:
    """Return the concatenation of all parts as a mesh."""
    uvs = None
    if any(part.uvs is not None for part in parts):
        blank = [
            np.zeros((len(part.vertices), 2), np.float32) if part.uvs is None else part.uvs for part in parts
        ]
        uvs = np.concatenate(blank)
    # The alpha cut-off of the mesh is the smallest of all materials; `_combine_colors` scales alpha to it.
    cutoffs = [part.base.cutoff for part in parts if part.base.cutoff is not None]
    is_textured = any(part.base.texture for part in parts)
    cutoff = min([1.0, *cutoffs]) if cutoffs and is_textured else None
    mesh = Mesh(
        np.concatenate([part.vertices for part in parts]),
        join_faces((part.faces for part in parts), [len(part.vertices) for part in parts]),
        _join_colors([_combine_colors(part, cutoff, _has_srgb_colors(document)) for part in parts], parts),
        vertex_uvs=uvs,
        vertex_keys=np.concatenate([part.keys for part in parts]),
    )
    return _with_textures(mesh, document, parts, cutoff) if is_textured else mesh


def _with_textures(
    mesh: Mesh, document: Document, parts: list[PrimitiveArrays], cutoff: float | None
) -> Mesh:
    """Return `mesh` with the distinct images of its parts, and the sampler of the first texture.

    If the source is read without images, only `face_textures` is set.
    """
    # Number the textures. An image that is used with and without an alpha cut-off becomes two textures,
    # because only one of them keeps its alpha channel.
    numbers: dict[Any, int] = {}
    images: list[tuple[TextureUse | None, bool]] = []
    of_parts = []
    for part in parts:
        texture, masked = part.base.texture, cutoff is not None and part.base.cutoff is not None
        key = None if texture is None else (identify_image(document, texture.image), masked)
        if key not in numbers:
            numbers[key] = len(images)
            images.append((texture, masked))
        of_parts.append(numbers[key])
    face_textures = np.repeat(np.array(of_parts, np.uint32), [len(part.faces) for part in parts])
    mesh = replace(mesh, face_textures=face_textures if len(images) > 1 else None)
    if not document.source.images:
        return mesh
    if len(images) > MAX_TEXTURES:
        text = f"the scene has {len(images)} textures; at most {MAX_TEXTURES} are supported"
        raise document.error("MESH_FILE_TOO_LARGE", "/images", text)
    decoder = Decoder()
    textures = tuple(_decode_texture(document, decoder, texture, masked) for texture, masked in images)
    samplers = [texture.sampler for texture, _ in images if texture is not None]
    return replace(mesh, textures=textures, sampler=replace(samplers[0], alpha_cutoff=cutoff))


def _decode_texture(
    document: Document, decoder: Decoder, texture: TextureUse | None, masked: bool
) -> NDArray[np.uint8]:
    """Return the texels of a texture, with alpha only if `masked`; white for None."""
    if texture is None:
        return _PLAIN
    data, pointer = read_image_bytes(document, texture.image)
    try:
        return decoder.decode(data, alpha=masked)
    except MeshFileError as error:
        raise document.error(error.code, pointer, error.message) from None


def _has_srgb_colors(document: Document) -> bool:
    """Return whether vertex colours are marked as sRGB, as in files written with `--color srgb`."""
    asset = document.root.get("asset")
    extras = asset.get("extras") if isinstance(asset, dict) else None
    return isinstance(extras, dict) and extras.get("color_space") == "srgb"


def _combine_colors(part: PrimitiveArrays, cutoff: float | None, is_srgb: bool) -> NDArray[Any] | None:
    """Return the sRGB colours (V, 3 | 4) of a part: vertex colours times the base factor; None for white.

    `cutoff` is the alpha cut-off of the mesh. If the part's cut-off differs, alpha is scaled by their ratio;
    if the part has none, alpha is 1. Without a `cutoff`, alpha is kept as stored and has no effect.
    """
    factor, part_cutoff = np.array(part.base.factor, np.float32), part.base.cutoff
    if cutoff is None or part_cutoff is None:
        factor[3] = 1
    else:  # in float64: the cut-offs may be too small or too large for float32
        factor[3] = part.base.factor[3] * (cutoff / part_cutoff)
    colors = part.colors
    if colors is None:
        if (factor == 1).all():
            return None
        width = 3 if factor[3] == 1 else 4
        return np.repeat(srgb_colors(factor[None, :width]), len(part.vertices), axis=0)
    if cutoff is not None:
        colors = with_alpha(colors) if part_cutoff is not None else colors[:, :3]
    width = colors.shape[1]
    if (factor[:width] == 1).all():
        return colors if is_srgb else srgb_colors(colors, part.most)
    return srgb_colors(as_floats(colors) * factor[:width])


def _join_colors(colors: list[NDArray[Any] | None], parts: list[PrimitiveArrays]) -> NDArray[Any] | None:
    """Return the concatenated colours (V, 3 | 4) in the widest type and width; None if all are white."""
    stored = [rows for rows in colors if rows is not None]
    if not stored:
        return None
    as_bytes = all(rows.dtype == np.uint8 for rows in stored)
    wide = any(rows.shape[1] == 4 for rows in stored)
    joined = []
    for part, rows in zip(parts, colors, strict=True):
        part_colors = np.full((len(part.vertices), 3), 255, dtype=np.uint8) if rows is None else rows
        part_colors = part_colors if as_bytes else as_floats(part_colors)
        joined.append(with_alpha(part_colors) if wide else part_colors)
    return np.concatenate(joined)


def _list_left_out(document: Document, meshes: Iterable[int], colors: list[BaseColor]) -> Iterable[str]:
    """Return the names of everything in the `meshes` of the scene, and in the file, that is not read.

    Malformed entries are skipped, because they are not read anyway.
    """
    parts: dict[str, None] = {}
    textures = [color.texture for color in colors if color.texture is not None]
    read = {f"TEXCOORD_{texture.uv_set}" for texture in textures}
    primitives = [
        primitive
        for mesh in meshes
        for primitive in _filter_objects(document.entry("meshes", mesh)[0].get("primitives"))
    ]
    # Attributes and morph targets of the primitives.
    for primitive in primitives:
        for name in _list_keys(primitive.get("attributes")):
            word = str(name).partition("_")[0]
            if name not in ("POSITION", "COLOR_0", *read):
                title = "further UVs" if read and word == "TEXCOORD" else _ATTRIBUTES.get(word)
                parts[title or "further attributes"] = None
        if primitive.get("targets"):
            parts["morph targets"] = None
    # Properties of the materials.
    if any(color.is_lost for color in colors):
        parts["textures without UVs or in formats other than PNG, JPEG and WebP"] = None
    if not textures and any(color.cutoff is not None for color in colors):
        parts["an alpha cut-off"] = None
    if len({texture.sampler for texture in textures}) > 1:
        parts["further samplers"] = None
    parts.update(dict.fromkeys(list_other_properties(document, primitives)))
    # Instances and animations.
    nodes = _filter_objects(document.root.get("nodes"))
    if any(_INSTANCES in _list_keys(node.get("extensions")) for node in nodes):
        parts[f"instances of meshes ({_INSTANCES})"] = None
    animations = document.root.get("animations")
    if isinstance(animations, list) and animations:
        parts[f"{len(animations)} animation{'' if len(animations) == 1 else 's'}"] = None
    return parts


def _filter_objects(entries: Any) -> list[dict[str, Any]]:
    """Return the objects in the JSON array `entries`; an empty list for other values."""
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _list_keys(entry: Any) -> list[Any]:
    """Return the keys of the JSON object `entry`; an empty list for other values."""
    return list(entry) if isinstance(entry, dict) else []


def _read_glb(source: Source) -> Mesh:
    """Read the default scene of a GLB file."""
    return read_scene(open_document(source))


def _read_gltf(source: Source) -> Mesh:
    """Read the default scene of a glTF file in JSON."""
    if _BEGINS.match(source.data) is None:
        raise source.not_a("glTF", "the content does not begin with '{'")
    document = parse_document(source, source.data)
    version = str(document.object(document.root, "asset", "").get("version", "2.0"))
    if not version.startswith("2."):
        text = f"glTF version {shorten(version)} is not supported; export version 2.0"
        raise document.error("MESH_FILE_UNSUPPORTED", "/asset/version", text)
    return read_scene(document)


FORMATS = (
    Format(
        "glTF",
        (".gltf",),
        _read_gltf,
        begins=_BEGINS,
        keeps=("vertex_colors", "vertex_uvs"),
        is_single=True,
        up="+y",
    ),
    Format(
        "GLB",
        (".glb",),
        _read_glb,
        write,
        begins=re.compile(rb"glTF"),
        keeps=("vertex_colors", "vertex_uvs", "textures"),
        is_single=True,
        is_linear=True,
        up="+y",
    ),
)
