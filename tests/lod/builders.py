"""Small GLB files with everything that a level of detail keeps."""

import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

from msb.meshes.glb_write import GlbBuilder, finish
from msb.meshes.gltf import Document, open_document
from msb.meshes.source import Source


def open_glb(data: bytes) -> Document:
    return open_document(Source("test.glb", data))


def root_of(data: bytes) -> dict[str, Any]:
    """Return the JSON of a GLB."""
    (size,) = struct.unpack_from("<I", data, 12)
    root: dict[str, Any] = json.loads(data[20 : 20 + size])
    return root


def sphere(rows: int = 24, columns: int = 48) -> dict[str, np.ndarray]:
    """Return positions, normals, tangents, UVs and faces of a bumpy sphere with a seam."""
    v, u = np.mgrid[0 : 1 : (rows + 1) * 1j, 0 : 1 : (columns + 1) * 1j]
    polar, turn = np.pi * v, 2 * np.pi * (u % 1)
    width = np.sin(polar).round(12)  # exactly 0 at the poles
    normal = np.stack([width * np.cos(turn), np.cos(polar), width * np.sin(turn)], axis=-1)
    radius = 1 + 0.1 * np.cos(6 * turn) * width**4
    tangent = np.stack([-np.sin(turn), 0 * turn, np.cos(turn), 1 + 0 * turn], axis=-1)
    first = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    a, b, c, d = first, first + 1, first + columns + 1, first + columns + 2
    faces = np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)
    positions = (normal * radius[..., None]).reshape(-1, 3)
    faces = faces[[len(np.unique(positions[f].round(9), axis=0)) == 3 for f in faces]]
    arrays = {"POSITION": positions, "NORMAL": normal, "TANGENT": tangent, "TEXCOORD_0": np.stack([u, v], -1)}
    return {k: a.reshape(-1, a.shape[-1]).astype("<f4") for k, a in arrays.items()} | {"faces": faces}


def picture(kind: str, side: int = 64) -> bytes:
    y, x = np.mgrid[0:side, 0:side]
    texels = np.stack([40 + x, 40 + y, 60 + (x // 8 + y // 8) % 2 * 120], axis=-1).astype(np.uint8)
    if kind == "normal":
        texels = np.broadcast_to(np.array((128, 128, 255), np.uint8), texels.shape).copy()
        texels[:, ::2, 0] = 190
    file = io.BytesIO()
    Image.fromarray(texels).save(file, "jpeg" if kind == "jpeg" else "png")
    return file.getvalue()


def make_glb(parts: int = 1, **changes: Any) -> bytes:
    """Return a file: a sphere of `parts` bands of materials below two nodes, with an animation and extras."""
    root: dict[str, Any] = {
        "asset": {"version": "2.0", "copyright": "us"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "base", "children": [1], "translation": [0, 2, 0], "extras": {"team": 7}},
            {"name": "ball", "mesh": 0, "rotation": [0, 0.6, 0, 0.8]},
        ],
        "materials": [
            {
                "name": f"paint {number}",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "roughnessFactor": 0.4},
                "normalTexture": {"index": 1, "scale": 0.5},
                "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 0.3}},
            }
            for number in range(parts)
        ],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 33071}],
        "extensionsUsed": ["KHR_materials_clearcoat"],
        **changes,
    }
    builder = GlbBuilder(root)

    def add(values: np.ndarray, kind: str, *, target: int | None = 34962, bounds: bool = False) -> int:
        view = {**builder.put(values), **({"target": target} if target else {})}
        number = {"f": 5126, "u": 5125}[values.dtype.kind]
        entry = {"bufferView": builder.add("bufferViews", view), "componentType": number, "type": kind}
        entry |= {"count": values.size // {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[kind]}
        if bounds:
            low, high = values.reshape(entry["count"], -1).min(0), values.reshape(entry["count"], -1).max(0)
            entry |= {"min": low.tolist(), "max": high.tolist()}
        return builder.add("accessors", entry)

    arrays = sphere()
    attributes = {
        name: add(values, f"VEC{values.shape[1]}", bounds=name == "POSITION")
        for name, values in arrays.items()
        if name != "faces"
    }
    primitives = [
        {
            "attributes": attributes,
            "indices": add(faces.astype("<u4").reshape(-1), "SCALAR", target=34963),
            "material": number,
        }
        for number, faces in enumerate(np.array_split(arrays["faces"], parts))
    ]
    builder.add("meshes", {"name": "round", "primitives": primitives, "extras": {"price": 3}})
    times = add(np.array([0, 1], "<f4"), "SCALAR", target=None, bounds=True)
    moves = add(np.array([[0, 2, 0], [0, 3, 0]], "<f4"), "VEC3", target=None)
    root["animations"] = [
        {
            "samplers": [{"input": times, "output": moves}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
        }
    ]
    for kind in ("jpeg", "normal"):
        view = builder.add("bufferViews", builder.put(picture(kind)))
        builder.add(
            "images", {"bufferView": view, "mimeType": f"image/{'jpeg' if kind == 'jpeg' else 'png'}"}
        )
    file = io.BytesIO()
    finish(builder, file)
    return file.getvalue()
