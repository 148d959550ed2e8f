"""glTF 2.0: what a file shows, as one mesh with its triangles, colours and textures.

GLB is all in one binary file; JSON, whose buffers and images lie beside it or in its text, is only read.
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
from msb.meshes.gltf import Document, document_of, open_document, placed_meshes
from msb.meshes.gltf_materials import Look, Shown, beyond, image_key, stored_image
from msb.meshes.gltf_packed import DRACO, MESHOPT, unpack
from msb.meshes.gltf_parts import Part, moved, primitives_of, read_part
from msb.meshes.images import Decoder
from msb.meshes.mesh import Mesh
from msb.meshes.polygons import joined_faces
from msb.meshes.source import Source

# Prefixes of extensions that a file may require: they change no geometry, or we read what they add.
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

# Attribute without its number -> what it is.
_ATTRIBUTES = {
    "NORMAL": "normals",
    "TANGENT": "tangents",
    "TEXCOORD": "UVs",
    "COLOR": "further colours",
    "JOINTS": "a skin",
    "WEIGHTS": "a skin",
}
# Says that a node is drawn at several places; a file that does not require it is read as if it did not.
_INSTANCES = "EXT_mesh_gpu_instancing"
# The texture of faces without one, where others have one.
_PLAIN = np.full((1, 1, 3), 255, np.uint8)
_BEGINS = re.compile(rb"\s*\{")


def read_scene(document: Document) -> Mesh:
    """Return the triangles of the default scene, primitive after primitive, in ascending order of nodes.

    Vertices are float32 as long as no node moves any, else float64. Every primitive brings its own vertices;
    where only some have colours, the others are white, as the format defines. An index outside its primitive
    stays outside the whole mesh.
    """
    _refuse_extensions(document)
    placed = list(placed_meshes(document))
    shown = list(dict.fromkeys(mesh for mesh, _ in placed))
    unpack(document, shown)
    primitives = {mesh: primitives_of(document, mesh) for mesh in shown}
    sizes = {mesh: sum(each.bytes for each in primitives[mesh]) for mesh in primitives}
    document.check_total("the arrays of its nodes", sum(sizes[mesh] for mesh, _ in placed))
    if not any(primitives.values()) and document.root.get("meshes"):
        text = "the scene shows no mesh with triangles, although the file has meshes"
        raise document.source.error("MESH_FILE_INVALID", text)
    read = {mesh: [read_part(each) for each in primitives[mesh]] for mesh in primitives}
    parts = [moved(part, matrix) for mesh, matrix in placed for part in read[mesh]]
    if not parts:
        joined = Mesh(np.zeros((0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int64))
    else:
        joined = _join(document, parts)
    looks = [part.look for part in parts]
    return replace(joined, left_out=tuple(_left_out(document, shown, looks)), up="+y")


def _refuse_extensions(document: Document) -> None:
    """Refuse a file that requires what we do not know: its accessors may hold nothing without that."""
    for name in document.array(document.root, "extensionsRequired", ""):
        if not str(name).startswith(_HARMLESS):
            text = f"the file requires extension {shorten(str(name))}, which is not read; export without it"
            raise document.error("MESH_FILE_UNSUPPORTED", "/extensionsRequired", text)


def _join(document: Document, parts: list[Part]) -> Mesh:
    """Return the mesh of all parts, one after the other."""
    uvs = None
    if any(part.uvs is not None for part in parts):
        blank = [
            np.zeros((len(part.vertices), 2), np.float32) if part.uvs is None else part.uvs for part in parts
        ]
        uvs = np.concatenate(blank)
    cutoffs = [part.look.cutoff for part in parts if part.look.cutoff is not None]
    is_textured = any(part.look.shown for part in parts)
    cutoff = min([1.0, *cutoffs]) if cutoffs and is_textured else None
    mesh = Mesh(
        np.concatenate([part.vertices for part in parts]),
        joined_faces((part.faces for part in parts), [len(part.vertices) for part in parts]),
        _join_colors([_colors(part, cutoff, _says_srgb(document)) for part in parts], parts),
        vertex_uvs=uvs,
    )
    return _with_textures(mesh, document, parts, cutoff) if is_textured else mesh


def _with_textures(mesh: Mesh, document: Document, parts: list[Part], cutoff: float | None) -> Mesh:
    """Return `mesh` with the images that its parts show, each once, and the sampler of the first of them.

    Where no images are wanted it is only said which faces show the same one.
    """
    numbers: dict[Any, int] = {}
    images: list[tuple[Shown | None, bool]] = []
    of_parts = []
    for part in parts:
        shown, masked = part.look.shown, cutoff is not None and part.look.cutoff is not None
        key = None if shown is None else (image_key(document, shown.image), masked)
        if key not in numbers:
            numbers[key] = len(images)
            images.append((shown, masked))
        of_parts.append(numbers[key])
    face_textures = np.repeat(np.array(of_parts, np.uint32), [len(part.faces) for part in parts])
    mesh = replace(mesh, face_textures=face_textures if len(images) > 1 else None)
    if not document.source.images:
        return mesh
    if len(images) > MAX_TEXTURES:
        text = f"the scene shows {len(images)} textures; {MAX_TEXTURES} are the most that a mesh has here"
        raise document.error("MESH_FILE_TOO_LARGE", "/images", text)
    decoder = Decoder()
    textures = tuple(_texture(document, decoder, shown, masked) for shown, masked in images)
    samplers = [shown.sampler for shown, _ in images if shown is not None]
    return replace(mesh, textures=textures, sampler=replace(samplers[0], alpha_cutoff=cutoff))


def _texture(document: Document, decoder: Decoder, shown: Shown | None, masked: bool) -> NDArray[np.uint8]:
    """Return the texels of an image; alpha counts only where something is cut off by it."""
    if shown is None:
        return _PLAIN
    data, pointer = stored_image(document, shown.image)
    try:
        return decoder.decode(data, alpha=masked)
    except MeshFileError as error:
        raise document.error(error.code, pointer, error.message) from None


def _says_srgb(document: Document) -> bool:
    """Return whether the file says that its vertex colours are sRGB, as ours do where that was asked for."""
    about = document.root.get("asset")
    extras = about.get("extras") if isinstance(about, dict) else None
    return isinstance(extras, dict) and extras.get("color_space") == "srgb"


def _colors(part: Part, cutoff: float | None, is_srgb: bool) -> NDArray[Any] | None:
    """Return the colours (V, 3 | 4) of a part in sRGB: those of its vertices times its factor; None is white.

    Of a mesh with a `cutoff` alpha is scaled as that differs from the part's own, and 1 where the part has
    none; else it is as stored, and has no effect.
    """
    factor, own = np.array(part.look.factor, np.float32), part.look.cutoff
    if cutoff is None or own is None:
        factor[3] = 1
    else:  # in doubles: a cut-off may be too small or too large for the floats of a colour
        factor[3] = part.look.factor[3] * (cutoff / own)
    colors = part.colors
    if colors is None:
        if (factor == 1).all():
            return None
        width = 3 if factor[3] == 1 else 4
        return np.repeat(srgb_colors(factor[None, :width]), len(part.vertices), axis=0)
    if cutoff is not None:
        colors = with_alpha(colors) if own is not None else colors[:, :3]
    width = colors.shape[1]
    if (factor[:width] == 1).all():
        return colors if is_srgb else srgb_colors(colors, part.most)
    return srgb_colors(as_floats(colors) * factor[:width])


def _join_colors(colors: list[NDArray[Any] | None], parts: list[Part]) -> NDArray[Any] | None:
    """Return the colours (V, 3 | 4) of all parts in the widest type and width; None if all are white."""
    given = [each for each in colors if each is not None]
    if not given:
        return None
    as_bytes = all(each.dtype == np.uint8 for each in given)
    wide = any(each.shape[1] == 4 for each in given)
    joined = []
    for part, each in zip(parts, colors, strict=True):
        own = np.full((len(part.vertices), 3), 255, dtype=np.uint8) if each is None else each
        own = own if as_bytes else as_floats(own)
        joined.append(with_alpha(own) if wide else own)
    return np.concatenate(joined)


def _left_out(document: Document, meshes: Iterable[int], looks: list[Look]) -> Iterable[str]:
    """Return what is not read of the `meshes` of a scene, and of the file beside meshes.

    What is malformed here is no error: it is not read.
    """
    parts: dict[str, None] = {}
    shown = [look.shown for look in looks if look.shown is not None]
    read = {f"TEXCOORD_{each.uv_set}" for each in shown}
    primitives = [
        each for mesh in meshes for each in _objects(document.entry("meshes", mesh)[0].get("primitives"))
    ]
    for primitive in primitives:
        for name in _keys(primitive.get("attributes")):
            word = str(name).partition("_")[0]
            if name not in ("POSITION", "COLOR_0", *read):
                what = "further UVs" if read and word == "TEXCOORD" else _ATTRIBUTES.get(word)
                parts[what or "further attributes"] = None
        if primitive.get("targets"):
            parts["morph targets"] = None
    if any(look.is_lost for look in looks):
        parts["textures that are no PNG, JPEG or WebP or have no UVs"] = None
    if not shown and any(look.cutoff is not None for look in looks):
        parts["a cut-off by alpha"] = None
    if len({each.sampler for each in shown}) > 1:
        parts["further samplers"] = None
    parts.update(dict.fromkeys(beyond(document, primitives)))
    nodes = _objects(document.root.get("nodes"))
    if any(_INSTANCES in _keys(node.get("extensions")) for node in nodes):
        parts[f"further copies of meshes ({_INSTANCES})"] = None
    animations = document.root.get("animations")
    if isinstance(animations, list) and animations:
        parts[f"{len(animations)} animation{'' if len(animations) == 1 else 's'}"] = None
    return parts


def _objects(entries: Any) -> list[dict[str, Any]]:
    return [each for each in entries if isinstance(each, dict)] if isinstance(entries, list) else []


def _keys(entry: Any) -> list[Any]:
    return list(entry) if isinstance(entry, dict) else []


def _read_glb(source: Source) -> Mesh:
    """Read what a binary file shows."""
    return read_scene(open_document(source))


def _read_gltf(source: Source) -> Mesh:
    """Read what a file of JSON shows."""
    if _BEGINS.match(source.data) is None:
        raise source.not_a("glTF", "it does not begin with '{'")
    document = document_of(source, source.data)
    version = str(document.object(document.root, "asset", "").get("version", "2.0"))
    if not version.startswith("2."):
        text = f"version {shorten(version)} is not read; 2.0 is"
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
