"""Reads the base colours of glTF materials, and names other properties of materials."""

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
_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
# Maps keys of unread material properties to names for messages.
_OTHERS = {
    "normalTexture": "normal maps",
    "occlusionTexture": "occlusion maps",
    "emissiveTexture": "emission",
    "emissiveFactor": "emission",
    "metallicRoughnessTexture": "metallic-roughness maps",
}


@dataclass(frozen=True)
class TextureUse:
    """The use of an image by a material.

    The field `image` is the index of the image. The field `uv_set` is the index of the set of texture
    coordinates. The field `transform` (2, 3) is the matrix that is multiplied with (u, v, 1), or None for the
    identity.
    """

    image: int
    sampler: Sampler
    uv_set: int
    transform: tuple[tuple[float, ...], ...] | None


@dataclass(frozen=True)
class BaseColor:
    """The base colour of a material is the product of `factor` and `texture`. The factor is RGBA in linear
    light.

    The field `cutoff` is the alpha cut-off. The value None means that alpha is ignored. The field `is_lost`
    is set if the material has a texture that cannot be read.
    """

    factor: tuple[float, ...] = _WHITE
    cutoff: float | None = None
    texture: TextureUse | None = None
    is_lost: bool = False


def read_base_color(document: Document, primitive: dict[str, Any], pointer: str) -> BaseColor:
    """Return the base colour of a primitive. The colour is white without a material."""
    if "material" not in primitive:
        return BaseColor()
    material, where = document.entry("materials", document.integer(primitive, "material", pointer))
    surface, where_surface, names = _find_surface(document, material, where)
    factor_key, texture_key = names
    factor = document.numbers(surface, factor_key, where_surface, _WHITE).clip(0, 1)
    cutoff = None
    if material.get("alphaMode") == "MASK":
        cutoff = max(document.number(material, "alphaCutoff", where, _CUTOFF), 0) or None
    texture = None
    if texture_key in surface:
        entry = document.object(surface, texture_key, where_surface)
        texture = _parse_texture_use(document, entry, f"{where_surface}/{texture_key}")
    is_lost = texture_key in surface and texture is None
    return BaseColor(tuple(factor.tolist()), cutoff, texture, is_lost)


def _find_surface(
    document: Document, material: dict[str, Any], pointer: str
) -> tuple[dict[str, Any], str, tuple[str, str]]:
    """Return the JSON object of a material's colour, its JSON pointer, and the keys of the factor and the
    texture.

    Usually, the colour of a material is the base colour of the metallic-roughness model. If the
    metallic-roughness model has no base colour, the diffuse colour of the specular-glossiness model is used.
    If only the diffuse colour has a texture, the diffuse colour also takes precedence.
    """
    surface = document.object(material, "pbrMetallicRoughness", pointer)
    extensions = document.object(material, "extensions", pointer)
    diffuse = document.object(extensions, _GLOSSINESS, f"{pointer}/extensions")
    is_fallback = "baseColorFactor" in surface and "diffuseTexture" not in diffuse
    if _GLOSSINESS not in extensions or "baseColorTexture" in surface or is_fallback:
        return surface, f"{pointer}/pbrMetallicRoughness", ("baseColorFactor", "baseColorTexture")
    return diffuse, f"{pointer}/extensions/{_GLOSSINESS}", ("diffuseFactor", "diffuseTexture")


def _parse_texture_use(document: Document, entry: dict[str, Any], pointer: str) -> TextureUse | None:
    """Return the texture that a `textureInfo` describes.

    Return None if the format of the image is not supported (KTX2).
    """
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
        sampler = _parse_sampler(
            *document.entry("samplers", document.integer(texture, "sampler", where)), document
        )
    uv_set = document.integer(entry, "texCoord", pointer, default=0)
    extensions = document.object(entry, "extensions", pointer)
    if _TRANSFORM not in extensions:
        return TextureUse(image, sampler, uv_set, None)
    where = f"{pointer}/extensions/{_TRANSFORM}"
    moved = document.object(extensions, _TRANSFORM, f"{pointer}/extensions")
    uv_set = document.integer(moved, "texCoord", where, default=uv_set)
    u, v = document.numbers(moved, "offset", where, (0, 0)).tolist()
    along_u, along_v = document.numbers(moved, "scale", where, (1, 1)).tolist()
    angle = document.number(moved, "rotation", where, 0.0)
    cos, sin = math.cos(angle), math.sin(angle)
    # Apply the scale, then the counter-clockwise rotation (v points downwards), then the translation.
    transform = (cos * along_u, sin * along_v, u), (-sin * along_u, cos * along_v, v)
    return TextureUse(image, sampler, uv_set, transform)


def _parse_sampler(entry: dict[str, Any], pointer: str, document: Document) -> Sampler:
    """Return a sampler. Missing or unknown filters and wrap modes are replaced by the defaults."""
    least = entry.get("minFilter")
    nearest = entry.get("magFilter", least) in _NEAREST_FILTERS
    filter_: Filter = "nearest" if nearest else "linear"
    wraps = [document.integer(entry, key, pointer, default=10497) for key in ("wrapS", "wrapT")]
    u, v = (_WRAPS.get(wrap, "repeat") for wrap in wraps)
    return Sampler(filter_, least not in (_NEAREST, _LINEAR), u, v)


def transform_uvs(uvs: NDArray[np.float32], texture: TextureUse) -> NDArray[np.float32]:
    """Return texture coordinates (V, 2) with the transform of a texture applied."""
    if texture.transform is None:
        return uvs
    matrix = np.array(texture.transform)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(uvs.astype(np.float64) @ matrix[:, :2].T + matrix[:, 2], np.float32)


def name_image(document: Document, index: int) -> str:
    """Return the name of image `index` for messages: its file, the name in the JSON, or its JSON pointer."""
    entry, pointer = document.entry("images", index)
    uri = entry.get("uri")
    if isinstance(uri, str) and uri not in document.embedded and uri[:5].lower() != "data:":
        return uri
    return str(entry.get("name") or pointer)


def read_image_bytes(document: Document, index: int) -> bytes | memoryview:
    """Return the bytes of image `index`, from a buffer view or a file."""
    entry, pointer = document.entry("images", index)
    if "bufferView" in entry:
        return document.view(document.integer(entry, "bufferView", pointer))[0]
    return document.resource(entry, pointer, MAX_FILE)


def identify_image(document: Document, index: int) -> Any:
    """Return a key that identifies the stored data of image `index`.

    Images with equal keys have equal data.
    """
    entry, _ = document.entry("images", index)
    return str(entry["bufferView"]) if "bufferView" in entry else ("uri", str(entry.get("uri")))


def list_other_properties(document: Document, primitives: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield the names of the properties of materials, except the base colour.

    Malformed materials are skipped.
    """
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
            yield from (title for key, title in _OTHERS.items() if owner.get(key) not in (None, [0, 0, 0]))
        if material.get("alphaMode") == "BLEND":
            yield "alpha blending"
        extensions = material.get("extensions")
        if isinstance(extensions, dict):
            others = (name for name in extensions if name not in (_UNLIT, _GLOSSINESS))
            yield from (shorten(str(name), 40) for name in others)
            shine = extensions.get(_GLOSSINESS)
            if isinstance(shine, dict) and shine.keys() - {"diffuseFactor", "diffuseTexture"}:
                yield "specular colours and glossiness"
