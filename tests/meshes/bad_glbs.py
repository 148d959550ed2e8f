"""GLB files that are not valid: name -> content and the end of the code."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from .builders import (
    SMALL,
    SQUARE,
    Glb,
    glb_file,
    glb_square,
    glb_textured,
    picture,
    ply_floats,
    png_header,
)


def changed(change: Callable[[dict[str, Any]], object]) -> bytes:
    """Return the square as GLB with a change to its JSON."""
    made = glb_square()
    change(made.root)
    return made.bytes()


def with_accessor(number: int, **more: Any) -> bytes:
    return changed(lambda root: root["accessors"][number].update(more))


def with_view(number: int, **more: Any) -> bytes:
    return changed(lambda root: root["bufferViews"][number].update(more))


def with_node(**more: Any) -> bytes:
    return changed(lambda root: root["nodes"][0].update(more))


def with_primitive(**more: Any) -> bytes:
    return changed(lambda root: root["meshes"][0]["primitives"][0].update(more))


def sparse(replaced: list[int], **more: Any) -> bytes:
    """Return the square with a sparse accessor."""
    made = glb_square()
    places = {"bufferView": made.view(np.array(replaced, "<u2").tobytes()), "componentType": 5123}
    values = {"bufferView": made.view(ply_floats([[7, 7, 7]] * len(replaced)))}
    made.root["accessors"][0]["sparse"] = {
        "count": len(replaced),
        "indices": places,
        "values": values,
        **more,
    }
    return made.bytes()


def huge_sparse() -> bytes:
    """Return the square with a sparse accessor that has no values but one, and a huge count."""
    made = glb_square()
    places = {"bufferView": made.view(b"\0\0"), "componentType": 5123}
    values = {"bufferView": made.view(ply_floats([[7, 7, 7]]))}
    entry = {"componentType": 5126, "type": "VEC3", "count": 10**12}
    made.root["accessors"][0] = {**entry, "sparse": {"count": 1, "indices": places, "values": values}}
    return made.bytes()


def colors(count: int, dtype: str = "u1", kind: str = "VEC4") -> bytes:
    """Return the square with COLOR_0 of a certain count and type."""
    made = glb_square()
    width = int(kind[-1])
    number = made.accessor(np.zeros((count, width)), dtype, kind)
    made.root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = number
    return made.bytes()


def many_primitives(count: int, nodes: int) -> bytes:
    """Return a mesh of many parts that share one triangle, shown by many nodes."""
    made = Glb()
    position = made.accessor(SQUARE[:3], "f4", "VEC3")
    for _ in range(count):
        made.primitive(position)
    made.root["nodes"] = [{"mesh": 0}] * nodes
    made.root["scenes"] = [{"nodes": list(range(nodes))}]
    return made.bytes()


def text_root(text: str) -> bytes:
    return glb_file(text.encode("utf-8"))


def resized(length: int) -> bytes:
    """Return the square as GLB whose header announces another length."""
    content = SMALL[".glb"]
    return content[:8] + (len(content) + length).to_bytes(4, "little") + content[12:]


BAD_GLBS: dict[str, tuple[bytes, str]] = {
    "garbage": (b"\x80\x02garbage", "INVALID"),
    "header": (SMALL[".glb"][:11], "TRUNCATED"),
    "version": (glb_file(b"{}", version=1), "UNSUPPORTED"),
    "short": (SMALL[".glb"][:-1], "TRUNCATED"),
    "chunk size": (resized(0)[:12] + b"\xff\xff\xff\xff" + resized(0)[16:], "TRUNCATED"),
    "BIN first": (SMALL[".glb"].replace(b"JSON", b"BIN\0"), "INVALID"),
    "no BIN": (
        glb_file(json.dumps(glb_square().root | {"buffers": [{"byteLength": 60}]}).encode()),
        "TRUNCATED",
    ),
    "not JSON": (text_root("{nodes: 1}"), "INVALID"),
    "deep": (text_root('{"a":' + "[" * 100_000), "TOO_LARGE"),
    "large": (glb_file(b" " * (2**24 + 4)), "TOO_LARGE"),
    "extension": (
        changed(lambda root: root.update(extensionsRequired=["EXT_mesh_gpu_instancing"])),
        "UNSUPPORTED",
    ),
    "external buffer": (changed(lambda root: root["buffers"][0].update(uri="/etc/passwd")), "UNSUPPORTED"),
    "second buffer": (
        changed(
            lambda root: (root["buffers"].append({"byteLength": 48}), root["bufferViews"][0].update(buffer=1))
        ),
        "INVALID",
    ),
    "no buffer": (changed(lambda root: root.pop("buffers")), "INVALID"),
    "no view, huge": (
        changed(
            lambda root: (root["accessors"][0].pop("bufferView"), root["accessors"][0].update(count=10**12))
        ),
        "INVALID",
    ),
    "huge count": (with_accessor(0, count=10**12), "TRUNCATED"),
    "negative count": (with_accessor(0, count=-4), "INVALID"),
    "position type": (with_accessor(0, type="VEC2"), "INVALID"),
    "stride": (with_view(0, byteStride=4), "INVALID"),
    "sparse index": (sparse([1, 4]), "INVALID"),
    "sparse, huge base": (huge_sparse(), "TOO_LARGE"),
    "sparse count": (sparse([1], count=5), "INVALID"),
    "sparse values": (sparse([1, 2], values={"bufferView": 2}), "TRUNCATED"),
    "no accessor": (with_primitive(indices=9), "INVALID"),
    "no position": (with_primitive(attributes={}), "INVALID"),
    "mode": (with_primitive(mode=7), "INVALID"),
    "primitive null": (changed(lambda root: root["meshes"][0].update(primitives=[None])), "INVALID"),
    "four corners": (glb_square(indices=[0, 1, 2, 3]).bytes(), "INVALID"),
    "color count": (colors(3), "INVALID"),
    "color type": (colors(4, kind="VEC2"), "INVALID"),
    "color component": (colors(4, dtype="i2"), "INVALID"),
    "own child": (with_node(children=[0]), "INVALID"),
    "cycle without scene": (
        changed(
            lambda root: (root.pop("scenes"), root["nodes"].extend([{"children": [2]}, {"children": [1]}]))
        ),
        "INVALID",
    ),
    "negative child": (with_node(children=[-1]), "INVALID"),
    "no such mesh": (with_node(mesh=3), "INVALID"),
    "nothing shown": (changed(lambda root: root["nodes"][0].clear()), "INVALID"),
    "short matrix": (with_node(matrix=[1] * 15), "INVALID"),
    "infinite scale": (
        glb_file(
            json.dumps(glb_square().root).replace('"mesh": 0', '"mesh": 0, "scale": [1e999, 1, 1]').encode()
        ),
        "INVALID",
    ),
    "zero rotation": (with_node(rotation=[0, 0, 0, 0]), "INVALID"),
    "primitives times nodes": (many_primitives(2_000, 2_000), "TOO_LARGE"),
}


def texture(image: bytes | str) -> bytes:
    return glb_textured(image).bytes()


def material(**more: Any) -> bytes:
    """Return the textured square with a change to its base colour."""
    made = glb_textured()
    made.root["materials"][0]["pbrMetallicRoughness"].update(more)
    return made.bytes()


JPEG = picture(np.zeros((8, 8, 3), np.uint8), "JPEG")

BAD_GLBS |= {
    "image: file scheme": (texture("file:///etc/passwd"), "UNSUPPORTED"),
    "image: backslash": (texture("..\\a.png"), "UNSUPPORTED"),
    "image: NUL": (texture("a%00.png"), "UNSUPPORTED"),
    "image: a folder": (texture("."), "INVALID"),
    "image: not base64": (texture("data:image/png;base64,a$b"), "INVALID"),
    "image: no text": (
        texture(7),  # type: ignore[arg-type]
        "INVALID",
    ),
    "image: cut off": (texture(picture()[:-30]), "INVALID"),
    "image: 100,000 a side": (texture(png_header(100_000, 100_000)), "TOO_LARGE"),
    "image: many scans": (texture(JPEG[:-2] + b"\xff\xda" * 101 + JPEG[-2:]), "TOO_LARGE"),
    "texture: none": (material(baseColorTexture={"index": 3}), "INVALID"),
    "texture: no number": (material(baseColorTexture=[]), "INVALID"),
    "factor": (material(baseColorFactor=[1, 1, 1]), "INVALID"),
    "cut-off": (glb_textured(alphaMode="MASK", alphaCutoff="a").bytes(), "INVALID"),
}


def gltf(**buffer: Any) -> bytes:
    """Return the square as .gltf with a change to its buffer."""
    made = glb_square()
    text = json.loads(made.text())
    text["buffers"][0].update(buffer)
    return json.dumps(text).encode()


BAD_GLTFS: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "INVALID"),
    "a list": (b"[{}]", "INVALID"),
    "cut off": (gltf()[:-1], "INVALID"),
    "version": (b'{"asset": {"version": "1.1"}}', "UNSUPPORTED"),
    "no uri": (json.dumps(glb_square().root).encode(), "INVALID"),
    "absent": (gltf(uri="absent.bin"), "INVALID"),
    "up": (gltf(uri="../a.bin"), "UNSUPPORTED"),
    "half a character of base64": (gltf(uri="data:;base64,\ud800"), "INVALID"),
    "short": (gltf(uri="data:;base64,AAAA"), "TRUNCATED"),
    "huge": (gltf(byteLength=2**50), "INVALID"),
}


def packed(**more: Any) -> bytes:
    """Return the square whose vertices are compressed by meshopt, or so it says."""
    made = glb_square()
    view = made.root["bufferViews"][0]
    about = {"buffer": 0, "byteLength": 12, "byteStride": 12, "count": 4, "mode": "ATTRIBUTES"}
    made.root["buffers"].append({"byteLength": 48})
    made.root["bufferViews"][0] = view | {
        "buffer": 1,
        "extensions": {"EXT_meshopt_compression": about | more},
    }
    return made.bytes()


def draco(attributes: dict[str, Any], **accessor: Any) -> bytes:
    """Return the square as a primitive that Draco has compressed, or so it says."""
    made = glb_square()
    for entry in made.root["accessors"]:
        entry.pop("bufferView")
        entry.update(accessor)
    about = {"bufferView": 0, "attributes": attributes}
    made.root["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": about}
    return made.bytes()


BAD_GLBS |= {
    "meshopt: filter": (packed(filter=[]), "INVALID"),
    "meshopt: stride": (packed(byteStride=6), "INVALID"),
    "meshopt: size": (packed(count=5), "INVALID"),
    "meshopt: end": (packed(byteLength=99), "TRUNCATED"),
    "draco: no positions": (draco({"NORMAL": 0}), "INVALID"),
    "draco: no count": (draco({"POSITION": 0}, count=None), "INVALID"),
    "draco: huge": (draco({"POSITION": 0}, count=10**12), "TOO_LARGE"),
    "draco: no id": (draco({"POSITION": "a"}), "INVALID"),
}
