"""Meshes written as GLB."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.errors import OutputError
from msb.meshes.colors import with_alpha
from msb.meshes.gltf import CHUNK, HEADER
from msb.meshes.writing import as_float32

if TYPE_CHECKING:
    from msb.meshes.mesh import Mesh

_TRIANGLES = 4


def write(mesh: Mesh, stream: BinaryIO) -> None:
    """Write one unlit, two-sided mesh; positions become float32, and face colours are lost.

    uint8 colours are padded to four components, since glTF aligns elements to four bytes; float32 colours
    stay as they are.
    """
    if not len(mesh.faces):
        raise OutputError("OUTPUT_FORMAT_LIMIT", "GLB cannot hold a mesh without faces; use PLY")
    positions = as_float32(mesh.vertices, "GLB")
    arrays: list[tuple[NDArray[Any], str]] = [
        (positions.astype("<f4", copy=False), "POSITION"),
        (mesh.faces.ravel().astype("<u4"), "indices"),
    ]
    if mesh.vertex_colors is not None:
        arrays.append((_aligned_colors(mesh.vertex_colors), "COLOR_0"))
    if mesh.vertex_uvs is not None:
        arrays.append((mesh.vertex_uvs.astype("<f4", copy=False), "TEXCOORD_0"))
    text = json.dumps(_description(arrays, positions), separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    size = sum(array.nbytes for array, _ in arrays)
    total = HEADER.size + CHUNK.size + len(text) + CHUNK.size + size
    if total >= 2**32:
        raise OutputError(
            "OUTPUT_FORMAT_LIMIT", f"a GLB has at most 4 GiB, this one would have {total} bytes"
        )
    stream.write(HEADER.pack(b"glTF", 2, total) + CHUNK.pack(len(text), b"JSON") + text)
    stream.write(CHUNK.pack(size, b"BIN\0"))
    for array, _ in arrays:
        stream.write(np.ascontiguousarray(array).data)


def _aligned_colors(colors: NDArray[Any]) -> NDArray[Any]:
    """Return colours (V, 3 | 4) whose rows take a multiple of four bytes."""
    if colors.dtype == np.uint8 and colors.shape[1] == 3:
        return with_alpha(colors)
    return colors.astype(colors.dtype.newbyteorder("<"), copy=False)


def _description(arrays: list[tuple[NDArray[Any], str]], positions: NDArray[np.float32]) -> dict[str, Any]:
    """Return the JSON for `arrays`, which lie in the binary chunk one after the other."""
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for array, role in arrays:
        target = 34963 if role == "indices" else 34962
        views.append({"buffer": 0, "byteOffset": start, "byteLength": array.nbytes, "target": target})
        component = {"f4": 5126, "u4": 5125, "u1": 5121}[array.dtype.str[1:]]
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        entry = {"bufferView": len(accessors), "componentType": component, "count": len(array), "type": kind}
        if array.dtype == np.uint8:
            entry["normalized"] = True
        accessors.append(entry)
        start += array.nbytes
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    attributes = {role: number for number, (_, role) in enumerate(arrays) if role != "indices"}
    primitive = {"attributes": attributes, "indices": 1, "material": 0, "mode": _TRIANGLES}
    unlit = "KHR_materials_unlit"
    plain = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 1}
    return {
        "asset": {"version": "2.0", "generator": "MeshSplatBench", "extras": {"color_space": "srgb"}},
        "extensionsUsed": [unlit],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": plain, "extensions": {unlit: {}}, "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
