"""What a GLB holds that no reader of ours keeps, in a user's words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from msb.meshes.gltf import Document

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


def left_out(document: Document, meshes: Iterable[int]) -> tuple[str, ...]:
    """Return what is not read of the `meshes` of a scene, and of the file beside meshes.

    What is malformed here is no error: it is not read.
    """
    found: dict[str, None] = {}
    for mesh in dict.fromkeys(meshes):
        for primitive in _objects(document.entry("meshes", mesh)[0].get("primitives")):
            for name in _keys(primitive.get("attributes")):
                word = str(name).partition("_")[0]
                if word != "POSITION" and name != "COLOR_0":
                    found[_ATTRIBUTES.get(word, "further attributes")] = None
            if primitive.get("targets"):
                found["morph targets"] = None
    colored = [each for each in _objects(document.root.get("materials")) if _has_color(each)]
    for title, entries in (
        ("texture", document.root.get("textures")),
        ("material colour", colored),
        ("animation", document.root.get("animations")),
    ):
        if isinstance(entries, list) and entries:
            found[f"{len(entries)} {title}{'' if len(entries) == 1 else 's'}"] = None
    return tuple(found)


def _has_color(material: dict[str, Any]) -> bool:
    surface = material.get("pbrMetallicRoughness")
    factor = surface.get("baseColorFactor", _PLAIN) if isinstance(surface, dict) else _PLAIN
    return isinstance(factor, list) and factor[:3] != _PLAIN


def _objects(entries: Any) -> list[dict[str, Any]]:
    return [each for each in entries if isinstance(each, dict)] if isinstance(entries, list) else []


def _keys(entry: Any) -> list[Any]:
    return list(entry) if isinstance(entry, dict) else []
