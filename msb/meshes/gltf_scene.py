"""Reads the default scene of a glTF 2.0 file as one mesh with colours and textures.

GLB (one binary file) is read and written. glTF in JSON, with embedded or linked buffers and images, is only
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
from msb.meshes.gltf import (
    VISIBILITY,
    Document,
    list_placed_meshes,
    open_document,
    parse_document,
    place_nodes,
)
from msb.meshes.gltf_materials import (
    BaseColor,
    identify_image,
    list_other_properties,
    name_image,
    read_image_bytes,
)
from msb.meshes.gltf_packed import DRACO, MESHOPT, unpack
from msb.meshes.gltf_parts import PrimitiveArrays, parse_primitives, read_arrays
from msb.meshes.gltf_poses import Poses
from msb.meshes.images import Decoder, describe_lost_image
from msb.meshes.mesh import Mesh
from msb.meshes.placement import KEY, take_back
from msb.meshes.polygons import join_faces
from msb.meshes.source import Source

# Prefixes of extensions that a file may require. Allowed extensions are either supported or do not change the
# geometry.
_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_animation_",
    "KHR_audio",
    "KHR_interactivity",
    "KHR_xmp",
    "KHR_mesh_quantization",
    VISIBILITY,
    DRACO,
    *MESHOPT,
    "EXT_lights_",
    "EXT_texture_",
    "EXT_mesh_features",
    "EXT_instance_features",
    "EXT_structural_metadata",
    "MSFT_texture_",
    "MSFT_packing_",
    "CESIUM_primitive_outline",
)
# The parts of a file that only affect the appearance or the animation of a mesh. An unknown extension is
# harmless if only these parts use the extension.
_LOOKS = ("materials", "textures", "images", "samplers", "animations", "cameras")

# Names of unread attributes for messages, without the number of the set.
_ATTRIBUTES = {
    "NORMAL": "normals",
    "TANGENT": "tangents",
    "TEXCOORD": "UVs",
    "COLOR": "further colours",
    "JOINTS": "a skin",
    "WEIGHTS": "a skin",
}
# The extension for instances of a node. If a file uses this extension but does not require it, the file is
# read without instances.
_INSTANCES = "EXT_mesh_gpu_instancing"
# The white texture for faces without a texture, if other faces have a texture.
_PLAIN = np.full((1, 1, 3), 255, np.uint8)
_BEGINS = re.compile(rb"\s*\{")


def read_scene(document: Document) -> Mesh:
    """Return the triangles of the default scene. The primitives are stored in the order of their nodes.

    Vertices are float32, or float64 if a node has a transform. Primitives do not share vertices. If only some
    primitives have colours, the other primitives are white, as the format defines. An index that is invalid
    in its primitive is also invalid in the returned mesh.
    """
    _check_extensions(document)
    nodes = place_nodes(document)
    every = list(list_placed_meshes(document, nodes))
    placed = [mesh for mesh, is_hidden in every if not is_hidden]
    used = list(dict.fromkeys(entry.mesh for entry in placed))
    poses = Poses(document, nodes.worlds)
    unpack(document, used)
    # Check all descriptions and the total size of the arrays before any array is read.
    primitives = {mesh: parse_primitives(document, mesh) for mesh in used}
    sizes = {mesh: sum(primitive.bytes for primitive in primitives[mesh]) for mesh in primitives}
    total = sum(
        sizes[entry.mesh] + sum(poses.count_bytes(primitive, entry) for primitive in primitives[entry.mesh])
        for entry in placed
    )
    document.check_total("the arrays of all nodes", total)
    if not any(primitives.values()) and document.root.get("meshes"):
        text = "the scene contains no mesh with triangles, although the file has meshes"
        text += " that are hidden" if any(is_hidden for _, is_hidden in every) else ""
        raise document.source.error("MESH_FILE_INVALID", text)
    read = {mesh: [read_arrays(primitive) for primitive in primitives[mesh]] for mesh in primitives}
    parts = [
        poses.apply(part, primitive, entry)
        for entry in placed
        for part, primitive in zip(read[entry.mesh], primitives[entry.mesh], strict=True)
    ]
    colors = [part.base for part in parts]
    parts, images, lost = _decode_images(document, parts)
    if not parts:
        joined = Mesh(np.zeros((0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int64))
    else:
        joined = _join_parts(document, parts, images)
    hidden = len(every) - len(placed)
    left_out = _list_left_out(document, used, colors) | poses.left_out | lost
    left_out |= {f"{hidden} hidden mesh{'' if hidden == 1 else 'es'}": None} if hidden else {}
    if poses.is_skinned and "a skin" in left_out:
        del left_out["a skin"]
        left_out["a skin beyond its pose"] = None
    extras = document.root.get("asset", {}).get("extras")
    frame = extras.get(KEY) if isinstance(extras, dict) else None
    return take_back(replace(joined, left_out=tuple(left_out), up="+y"), frame)


def _check_extensions(document: Document) -> None:
    """Reject files that require an unsupported extension which may change the geometry."""
    required = [str(name) for name in document.array(document.root, "extensionsRequired", "")]
    unknown = [name for name in required if not name.startswith(_HARMLESS)]
    if not unknown:
        return
    places = _list_extended_parts(document)
    for name in unknown:
        if not places.get(name, {""}) <= set(_LOOKS):
            text = (
                f"the required extension {shorten(str(name))} is not supported; export the file without "
                "this extension"
            )
            raise document.error("MESH_FILE_UNSUPPORTED", "/extensionsRequired", text)


def _list_extended_parts(document: Document) -> dict[str, set[str]]:
    """For each extension, return the keys of the root object in whose values the extension occurs.

    The key "" means the root object itself.
    """
    places: dict[str, set[str]] = {}
    waiting: list[tuple[str, Any]] = [("", document.root)]
    while waiting:
        key, value = waiting.pop()
        if isinstance(value, dict):
            extensions = value.get("extensions")
            for name in extensions if isinstance(extensions, dict) else ():
                places.setdefault(name, set()).add(key)
            waiting += [(key or name, entry) for name, entry in value.items()]
        elif isinstance(value, list):
            waiting += [(key, entry) for entry in value]
    return places


def _find_cutoff(parts: list[PrimitiveArrays]) -> float | None:
    """Return the alpha cut-off of the mesh, which is the smallest cut-off of all materials.

    Return None without textures. `_combine_colors` scales alpha values to this cut-off.
    """
    cutoffs = [part.base.cutoff for part in parts if part.base.cutoff is not None]
    is_textured = any(part.base.texture for part in parts)
    return min([1.0, *cutoffs]) if cutoffs and is_textured else None


def _identify_texture(document: Document, part: PrimitiveArrays, cutoff: float | None) -> Any:
    """Return a key for the texture of a part. Return None without a texture.

    If an image is used both with and without an alpha cut-off, two textures are needed. Only one texture
    keeps the alpha channel.
    """
    if part.base.texture is None:
        return None
    is_masked = cutoff is not None and part.base.cutoff is not None
    return identify_image(document, part.base.texture.image), is_masked


def _decode_images(
    document: Document, parts: list[PrimitiveArrays]
) -> tuple[list[PrimitiveArrays], dict[Any, NDArray[np.uint8]], dict[str, None]]:
    """Return the parts, the texels of their textures, and the names of unreadable images.

    A part whose image cannot be read has no texture in the result. If the source is read without images, no
    image is decoded.
    """
    cutoff = _find_cutoff(parts)
    keys = [_identify_texture(document, part, cutoff) for part in parts]
    if not document.source.images or not any(keys):
        return parts, {}, {}
    if (count := len(set(keys))) > MAX_TEXTURES:
        text = f"the scene has {count} textures; at most {MAX_TEXTURES} are supported"
        raise document.error("MESH_FILE_TOO_LARGE", "/images", text)
    decoder, read = Decoder(), []
    images: dict[Any, NDArray[np.uint8] | None] = {}
    lost: dict[str, None] = {}
    for part, key in zip(parts, keys, strict=True):
        texture = part.base.texture
        if texture is not None and key not in images:
            try:
                data = read_image_bytes(document, texture.image)
                images[key] = decoder.decode(data, alpha=key[1])
            except MeshFileError as error:
                images[key] = None
                name = name_image(document, texture.image)
                lost[describe_lost_image(name, error.message)] = None
        is_lost = key is not None and images[key] is None
        read.append(replace(part, base=replace(part.base, texture=None)) if is_lost else part)
    return read, {key: image for key, image in images.items() if image is not None}, lost


def _join_parts(
    document: Document, parts: list[PrimitiveArrays], images: dict[Any, NDArray[np.uint8]]
) -> Mesh:
    """Concatenate all parts to a mesh. The argument `images` has the texels of their textures."""
    uvs = None
    if any(part.uvs is not None for part in parts):
        blank = [
            np.zeros((len(part.vertices), 2), np.float32) if part.uvs is None else part.uvs for part in parts
        ]
        uvs = np.concatenate(blank)
    cutoff = _find_cutoff(parts)
    mesh = Mesh(
        np.concatenate([part.vertices for part in parts]),
        join_faces((part.faces for part in parts), [len(part.vertices) for part in parts]),
        _join_colors([_combine_colors(part, cutoff, _has_srgb_colors(document)) for part in parts], parts),
        vertex_uvs=uvs,
        vertex_keys=np.concatenate([part.keys for part in parts]),
    )
    is_textured = any(part.base.texture for part in parts)
    return _with_textures(mesh, document, parts, images) if is_textured else mesh


def _with_textures(
    mesh: Mesh, document: Document, parts: list[PrimitiveArrays], images: dict[Any, NDArray[np.uint8]]
) -> Mesh:
    """Return `mesh` with the distinct textures of its parts, and the sampler of the first texture.

    If the source is read without images, only `face_textures` is set.
    """
    cutoff = _find_cutoff(parts)
    keys = [_identify_texture(document, part, cutoff) for part in parts]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    face_textures = np.repeat(
        np.array([numbers[key] for key in keys], np.uint32), [len(part.faces) for part in parts]
    )
    mesh = replace(mesh, face_textures=face_textures if len(numbers) > 1 else None)
    if not document.source.images:
        return mesh
    textures = tuple(_PLAIN if key is None else images[key] for key in numbers)
    sampler = next(part.base.texture.sampler for part in parts if part.base.texture is not None)
    return replace(mesh, textures=textures, sampler=replace(sampler, alpha_cutoff=cutoff))


def _has_srgb_colors(document: Document) -> bool:
    """Return whether vertex colours are marked as sRGB, as in files that `--color srgb` wrote."""
    asset = document.root.get("asset")
    extras = asset.get("extras") if isinstance(asset, dict) else None
    return isinstance(extras, dict) and extras.get("color_space") == "srgb"


def _combine_colors(part: PrimitiveArrays, cutoff: float | None, is_srgb: bool) -> NDArray[Any] | None:
    """Return the sRGB colours (V, 3 | 4) of a part, multiplied with the base factor.

    Return None if all colours are white. The argument `cutoff` is the alpha cut-off of the mesh. If the part
    has a different cut-off, alpha is multiplied with the ratio of the two cut-offs. Without a cut-off of the
    part, alpha is set to 1. If `cutoff` is None, alpha is returned unchanged, and renderers ignore it.
    """
    factor, part_cutoff = np.array(part.base.factor, np.float32), part.base.cutoff
    if cutoff is None or part_cutoff is None:
        factor[3] = 1
    else:  # Cut-offs may exceed the range of float32, so use float64.
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
    """Concatenate the colours (V, 3 | 4) in the widest type and width. Return None if all colours are
    white."""
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


def _list_left_out(document: Document, meshes: Iterable[int], colors: list[BaseColor]) -> dict[str, None]:
    """Return the names of all unread data in the file and in the given `meshes`.

    Malformed entries of the JSON are skipped.
    """
    parts: dict[str, None] = {}
    textures = [color.texture for color in colors if color.texture is not None]
    read = {f"TEXCOORD_{texture.uv_set}" for texture in textures}
    primitives = [
        primitive
        for mesh in meshes
        for primitive in _filter_objects(document.entry("meshes", mesh)[0].get("primitives"))
    ]
    # Names of attributes and morph targets of the primitives.
    for primitive in primitives:
        for name in _list_keys(primitive.get("attributes")):
            word = str(name).partition("_")[0]
            if name not in ("POSITION", "COLOR_0", *read):
                title = "further UVs" if read and word == "TEXCOORD" else _ATTRIBUTES.get(word)
                parts[title or "further attributes"] = None
        if primitive.get("targets"):
            parts["morph targets"] = None
    # Names of material properties.
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
    """Return the objects in the JSON array `entries`. If `entries` is not an array, return an empty list."""
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _list_keys(entry: Any) -> list[Any]:
    """Return the keys of the JSON object `entry`. If `entry` is not an object, return an empty list."""
    return list(entry) if isinstance(entry, dict) else []


def _read_glb(source: Source) -> Mesh:
    """Read the default scene of a GLB file."""
    return read_scene(open_document(source))


def open_text_document(source: Source) -> Document:
    """Return the document of a glTF file in JSON."""
    if _BEGINS.match(source.data) is None:
        raise source.not_a("glTF", "the content does not begin with '{'")
    document = parse_document(source, source.data)
    version = str(document.object(document.root, "asset", "").get("version", "2.0"))
    if not version.startswith("2."):
        text = f"glTF version {shorten(version)} is not supported; export version 2.0"
        raise document.error("MESH_FILE_UNSUPPORTED", "/asset/version", text)
    return document


def _read_gltf(source: Source) -> Mesh:
    """Read the default scene of a glTF file in JSON."""
    return read_scene(open_text_document(source))


FORMATS = (
    Format(
        "glTF",
        (".gltf",),
        _read_gltf,
        begins=_BEGINS,
        keeps=("vertex_colors", "vertex_uvs"),
        is_single=True,
        has_origin=True,
        up="+y",
    ),
    Format(
        "GLB",
        (".glb",),
        _read_glb,
        write,
        begins=re.compile(rb"glTF"),
        keeps=("vertex_colors", "vertex_uvs", "normals", "textures"),
        is_single=True,
        has_origin=True,
        is_linear=True,
        up="+y",
    ),
)
