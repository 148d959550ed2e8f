"""Materials of glTF: of each its base colour, and what else it has by name."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Filter, Sampler, Wrap
from msb.errors import shorten
from msb.meshes.gltf import Document
from msb.meshes.images import MAX_FILE

_WHITE = (1.0, 1.0, 1.0, 1.0)
_CUTOFF = 0.5
_NEAREST, _LINEAR = 9728, 9729
_NEAREST_FILTERS = (_NEAREST, 9984, 9986)
_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_UNLIT, _TRANSFORM, _WEBP = "KHR_materials_unlit", "KHR_texture_transform", "EXT_texture_webp"
# Keys of materials that are not read -> what they are.
_BEYOND = {
    "normalTexture": "normal maps",
    "occlusionTexture": "occlusion maps",
    "emissiveTexture": "emission",
    "emissiveFactor": "emission",
    "metallicRoughnessTexture": "maps of metal and roughness",
}


@dataclass(frozen=True)
class Shown:
    """A texture as a material shows it.

    `image` is the number of the image, `sampler` how it is read, `uv_set` the number of the texture
    coordinates, `transform` (2, 3) what they are multiplied with, as (u, v, 1).
    """

    image: int
    sampler: Sampler
    uv_set: int
    transform: tuple[tuple[float, ...], ...] | None


@dataclass(frozen=True)
class Look:
    """What is drawn of a material: `factor` in linear light, `cutoff` None where alpha has no effect.

    `is_lost` says that it has a texture, and that this cannot be shown.
    """

    factor: tuple[float, ...] = _WHITE
    cutoff: float | None = None
    shown: Shown | None = None
    is_lost: bool = False


def look_of(document: Document, primitive: dict[str, Any], pointer: str) -> Look:
    """Return the look of a primitive; without a material it is white."""
    if "material" not in primitive:
        return Look()
    material, where = document.entry("materials", document.integer(primitive, "material", pointer))
    surface = document.object(material, "pbrMetallicRoughness", where)
    where_surface = f"{where}/pbrMetallicRoughness"
    factor = document.numbers(surface, "baseColorFactor", where_surface, _WHITE).clip(0, 1)
    cutoff = None
    if material.get("alphaMode") == "MASK":
        cutoff = max(document.number(material, "alphaCutoff", where, _CUTOFF), 0) or None
    shown = None
    if "baseColorTexture" in surface:
        entry = document.object(surface, "baseColorTexture", where_surface)
        shown = _shown(document, entry, f"{where_surface}/baseColorTexture")
    is_lost = "baseColorTexture" in surface and shown is None
    return Look(tuple(factor.tolist()), cutoff, shown, is_lost)


def _shown(document: Document, entry: dict[str, Any], pointer: str) -> Shown | None:
    """Return the texture of a `textureInfo`; None where its image is of no kind that is read (KTX2)."""
    texture, where = document.entry("textures", document.integer(entry, "index", pointer))
    extensions = document.object(texture, "extensions", where)
    webp = document.object(extensions, _WEBP, f"{where}/extensions")
    owner = webp if "source" in webp else texture
    if "source" not in owner:
        return None
    image = document.integer(owner, "source", where)
    document.entry("images", image)
    sampler = Sampler()
    if "sampler" in texture:
        sampler = _sampler(*document.entry("samplers", document.integer(texture, "sampler", where)), document)
    uv_set = document.integer(entry, "texCoord", pointer, default=0)
    extensions = document.object(entry, "extensions", pointer)
    if _TRANSFORM not in extensions:
        return Shown(image, sampler, uv_set, None)
    where = f"{pointer}/extensions/{_TRANSFORM}"
    moved = document.object(extensions, _TRANSFORM, f"{pointer}/extensions")
    uv_set = document.integer(moved, "texCoord", where, default=uv_set)
    u, v = document.numbers(moved, "offset", where, (0, 0)).tolist()
    along_u, along_v = document.numbers(moved, "scale", where, (1, 1)).tolist()
    angle = document.number(moved, "rotation", where, 0.0)
    cos, sin = math.cos(angle), math.sin(angle)
    # Counter-clockwise as the texture is seen, with v downwards.
    transform = (cos * along_u, sin * along_v, u), (-sin * along_u, cos * along_v, v)
    return Shown(image, sampler, uv_set, transform)


def _sampler(entry: dict[str, Any], pointer: str, document: Document) -> Sampler:
    """Return a sampler of glTF; a number it does not define is as if absent."""
    least = entry.get("minFilter")
    nearest = entry.get("magFilter", least) in _NEAREST_FILTERS
    filter_: Filter = "nearest" if nearest else "linear"
    wraps = [document.integer(entry, key, pointer, default=10497) for key in ("wrapS", "wrapT")]
    u, v = (_WRAPS.get(wrap, "repeat") for wrap in wraps)
    return Sampler(filter_, least not in (_NEAREST, _LINEAR), u, v)


def transformed(uvs: NDArray[np.float32], shown: Shown) -> NDArray[np.float32]:
    """Return texture coordinates (V, 2) with the transform of a texture applied."""
    if shown.transform is None:
        return uvs
    matrix = np.array(shown.transform)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(uvs.astype(np.float64) @ matrix[:, :2].T + matrix[:, 2], np.float32)


def stored_image(document: Document, index: int) -> tuple[bytes | memoryview, str]:
    """Return the bytes of image `index`, of a view or a file, and its JSON pointer."""
    entry, pointer = document.entry("images", index)
    if "bufferView" in entry:
        return document.view(document.integer(entry, "bufferView", pointer))[0], pointer
    return document.resource(entry, pointer, MAX_FILE), pointer


def image_key(document: Document, index: int) -> Any:
    """Return what two images that are one have in common: where they are stored."""
    entry, _ = document.entry("images", index)
    return str(entry["bufferView"]) if "bufferView" in entry else ("uri", str(entry.get("uri")))


def beyond(document: Document, primitives: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield what the materials of primitives have beside their base colour; malformed ones have nothing."""
    materials = document.root.get("materials")
    for primitive in primitives:
        number = primitive.get("material")
        if not (isinstance(materials, list) and type(number) is int and 0 <= number < len(materials)):
            continue
        material = materials[number]
        if not isinstance(material, dict):
            continue
        surface = material.get("pbrMetallicRoughness")
        for owner in (material, surface if isinstance(surface, dict) else {}):
            yield from (what for key, what in _BEYOND.items() if owner.get(key) not in (None, [0, 0, 0]))
        if material.get("alphaMode") == "BLEND":
            yield "blending by alpha"
        extensions = material.get("extensions")
        if isinstance(extensions, dict):
            yield from (shorten(str(name), 40) for name in extensions if name != _UNLIT)
