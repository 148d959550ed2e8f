"""GLB files that are not valid: name -> content, the end of the code, and a piece of the message."""

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


def instanced(nodes: int) -> bytes:
    """Return a mesh of 3,000 vertices that many nodes show."""
    made = Glb()
    made.primitive(made.accessor(np.zeros((3000, 3)), "f4", "VEC3"))
    made.root["nodes"] = [{"mesh": 0}] * nodes
    made.root["scenes"] = [{"nodes": list(range(nodes))}]
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


BAD_GLBS: dict[str, tuple[bytes, str, str]] = {
    "empty": (b"", "INVALID", "the file is empty"),
    "garbage": (b"\x80\x02garbage", "INVALID", "it does not begin with 'glTF'"),
    "header": (SMALL[".glb"][:11], "TRUNCATED", "ends within its header"),
    "version": (glb_file(b"{}", version=1), "UNSUPPORTED", "version 1 is not read"),
    "short": (SMALL[".glb"][:-1], "TRUNCATED", "byte 8: the header says"),
    "chunk size": (
        resized(0)[:12] + b"\xff\xff\xff\xff" + resized(0)[16:],
        "TRUNCATED",
        "a chunk declares 4294967295",
    ),
    "no chunk": (b"glTF\2\0\0\0\x0c\0\0\0", "INVALID", "the first chunk is not JSON"),
    "BIN first": (SMALL[".glb"].replace(b"JSON", b"BIN\0"), "INVALID", "the first chunk is not JSON"),
    "no BIN": (
        glb_file(json.dumps(glb_square().root | {"buffers": [{"byteLength": 60}]}).encode()),
        "TRUNCATED",
        "of a buffer of 0 bytes",
    ),
    "not JSON": (text_root("{nodes: 1}"), "INVALID", "the JSON cannot be read"),
    "not UTF-8": (glb_file(b'{"a": "\xff"}'), "INVALID", "the JSON cannot be read"),
    "NaN": (text_root('{"a": NaN}'), "INVALID", "NaN is not JSON"),
    "deep": (text_root('{"a":' + "[" * 100_000), "TOO_LARGE", "nests 100001 deep, more than 64"),
    "deep in a string": (text_root('{"a":"' + "[" * 100_000), "INVALID", "the JSON cannot be read"),
    "long integer": (text_root('{"a":' + "9" * 5000 + "}"), "INVALID", "the JSON cannot be read"),
    "large": (glb_file(b" " * (2**24 + 4)), "TOO_LARGE", "more than 16777216"),
    "extension": (
        changed(lambda root: root.update(extensionsRequired=["EXT_mesh_gpu_instancing"])),
        "UNSUPPORTED",
        "requires extension EXT_mesh_gpu_instancing",
    ),
    "external buffer": (
        changed(lambda root: root["buffers"][0].update(uri="/etc/passwd")),
        "UNSUPPORTED",
        "/buffers/0/uri: '/etc/passwd' is not a relative path with forward slashes",
    ),
    "second buffer": (
        changed(
            lambda root: (root["buffers"].append({"byteLength": 48}), root["bufferViews"][0].update(buffer=1))
        ),
        "INVALID",
        "only the first buffer can lie in the binary chunk",
    ),
    "no buffer": (
        changed(lambda root: root.pop("buffers")),
        "INVALID",
        "/buffers/0: there is no such object",
    ),
    "no view, huge": (
        changed(
            lambda root: (root["accessors"][0].pop("bufferView"), root["accessors"][0].update(count=10**12))
        ),
        "INVALID",
        "no 'bufferView'",
    ),
    "huge count": (
        with_accessor(0, count=10**12),
        "TRUNCATED",
        "/accessors/0: 1000000000000 elements of 12 bytes",
    ),
    "negative count": (with_accessor(0, count=-4), "INVALID", "/accessors/0/count: 'count' is -4"),
    "count true": (with_accessor(0, count=True), "INVALID", "'count' is True"),
    "accessor offset": (
        with_accessor(0, byteOffset=4),
        "TRUNCATED",
        "4 elements of 12 bytes do not fit the 48",
    ),
    "position type": (with_accessor(0, type="VEC2"), "INVALID", "'type' is VEC2; VEC3 is right here"),
    "position component": (
        with_accessor(0, componentType=5125),
        "INVALID",
        "'componentType' 5125 is not allowed",
    ),
    "view beyond the end": (with_view(0, byteOffset=40), "TRUNCATED", "/bufferViews/0: it ends at byte 88"),
    "view overflow": (
        with_view(0, byteLength=2**62, byteOffset=2**62),
        "TRUNCATED",
        "/bufferViews/0: it ends",
    ),
    "stride": (with_view(0, byteStride=4), "INVALID", "'byteStride' is 4, less than the 12 bytes"),
    "large stride": (with_view(0, byteStride=2**60), "TRUNCATED", "do not fit"),
    "sparse index": (sparse([1, 4]), "INVALID", "/accessors/0/sparse: a sparse index is 4"),
    "sparse, huge base": (huge_sparse(), "TOO_LARGE", "the arrays of its nodes would take"),
    "sparse count": (sparse([1], count=5), "INVALID", "'count' is 5, not an integer from 0 to 4"),
    "sparse values": (sparse([1, 2], values={"bufferView": 2}), "TRUNCATED", "/accessors/0/sparse/values"),
    "no accessor": (with_primitive(indices=9), "INVALID", "/accessors/9: there is no such object"),
    "no position": (with_primitive(attributes={}), "INVALID", "'POSITION' is None"),
    "mode": (with_primitive(mode=7), "INVALID", "'mode' is 7, not an integer from 0 to 6"),
    "primitive null": (
        changed(lambda root: root["meshes"][0].update(primitives=[None])),
        "INVALID",
        "a primitive is",
    ),
    "four corners": (
        glb_square(indices=[0, 1, 2, 3]).bytes(),
        "INVALID",
        "4 corners are no whole number of triangles",
    ),
    "color count": (colors(3), "INVALID", "there are 3 colours for 4 vertices"),
    "color type": (colors(4, kind="VEC2"), "INVALID", "'type' is VEC2; VEC3 or VEC4 is right here"),
    "color component": (colors(4, dtype="i2"), "INVALID", "'componentType' 5122 is not allowed"),
    "own child": (with_node(children=[0]), "INVALID", "/nodes/0: the node is reached twice"),
    "cycle without scene": (
        changed(
            lambda root: (root.pop("scenes"), root["nodes"].extend([{"children": [2]}, {"children": [1]}]))
        ),
        "INVALID",
        "reached from no root",
    ),
    "two parents": (
        changed(lambda root: root.update(nodes=[{"children": [1, 2]}, {"children": [2]}, {}])),
        "INVALID",
        "/nodes/2: the node is reached twice",
    ),
    "negative child": (with_node(children=[-1]), "INVALID", "'-1' is not the number of one of the 1 nodes"),
    "no such mesh": (with_node(mesh=3), "INVALID", "/meshes/3: there is no such object"),
    "nothing shown": (
        changed(lambda root: root["nodes"][0].clear()),
        "INVALID",
        "shows no mesh with triangles",
    ),
    "short matrix": (with_node(matrix=[1] * 15), "INVALID", "'matrix' is not an array of 16 finite numbers"),
    "infinite scale": (
        glb_file(
            json.dumps(glb_square().root).replace('"mesh": 0', '"mesh": 0, "scale": [1e999, 1, 1]').encode()
        ),
        "INVALID",
        "'scale' is not an array of 3 finite numbers",
    ),
    "zero rotation": (with_node(rotation=[0, 0, 0, 0]), "INVALID", "'rotation' is no rotation"),
    "instances": (instanced(20_000), "TOO_LARGE", "the arrays of its nodes would take"),
    "primitives times nodes": (
        many_primitives(2_000, 2_000),
        "TOO_LARGE",
        "the arrays of its nodes would take",
    ),
}


def texture(image: bytes | str) -> bytes:
    return glb_textured(image).bytes()


def material(**more: Any) -> bytes:
    """Return the textured square with a change to its base colour."""
    made = glb_textured()
    made.root["materials"][0]["pbrMetallicRoughness"].update(more)
    return made.bytes()


JPEG = picture(np.zeros((8, 8, 3), np.uint8), "JPEG")
_FRAME = JPEG.index(b"\xff\xc0") + 5
HUGE_JPEG = JPEG[:_FRAME] + b"\xff\xdc\xff\xdc" + JPEG[_FRAME + 4 :]
"""A JPEG that says it is 65,500 x 65,500."""
HUGE_WEBP = b"RIFF\xff\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0\xff\xff\xff\xff\xff\xff"
UNSEEN = "only files in the folder of the mesh, or below it, are read"

BAD_GLBS |= {
    "image: absolute": (texture("/etc/passwd"), "UNSUPPORTED", UNSEEN),
    "image: host": (texture("//host/a.png"), "UNSUPPORTED", UNSEEN),
    "image: scheme": (texture("https://host/a.png"), "UNSUPPORTED", "names a scheme, a host or a drive"),
    "image: file scheme": (texture("file:///etc/passwd"), "UNSUPPORTED", "names a scheme"),
    "image: drive": (texture("C:/a.png"), "UNSUPPORTED", "a drive"),
    "image: backslash": (texture("..\\a.png"), "UNSUPPORTED", "forward slashes"),
    "image: up": (texture("a/%2e%2e/../b.png"), "UNSUPPORTED", "leaves the folder"),
    "image: NUL": (texture("a%00.png"), "UNSUPPORTED", "is no name of a file"),
    "image: empty name": (texture(""), "UNSUPPORTED", "is no name of a file"),
    "image: absent": (texture("absent.png"), "INVALID", "it needs 'absent.png' in its folder"),
    "image: a folder": (texture("."), "INVALID", "it is a folder"),
    "image: not base64": (texture("data:image/png;base64,a$b"), "INVALID", "the data is not base64"),
    "image: no text": (
        texture(7),  # type: ignore[arg-type]
        "INVALID",
        "/images/0/uri: 'uri' is no text",
    ),
    "image: none": (texture(b"\x89PNG"), "INVALID", "it is no PNG, JPEG or WebP image"),
    "image: cut off": (texture(picture()[:-30]), "INVALID", "it cannot be decoded"),
    "image: 100,000 a side": (texture(png_header(100_000, 100_000)), "TOO_LARGE", "it is 100000 x 100000"),
    "image: a large JPEG": (texture(HUGE_JPEG), "TOO_LARGE", "it is 65500 x 65500"),
    "image: a large WebP": (texture(HUGE_WEBP), "TOO_LARGE", "it is 16777216 x 16777216"),
    "image: a bomb": (texture(png_header(16_384, 16_384)), "TOO_LARGE", "texels need 1073741824 bytes"),
    "image: many scans": (
        texture(JPEG[:-2] + b"\xff\xda" * 101 + JPEG[-2:]),
        "TOO_LARGE",
        "more than 100 scans",
    ),
    "texture: none": (material(baseColorTexture={"index": 3}), "INVALID", "/textures/3: there is no such"),
    "texture: no number": (material(baseColorTexture=[]), "INVALID", "'baseColorTexture' is not an object"),
    "factor": (material(baseColorFactor=[1, 1, 1]), "INVALID", "'baseColorFactor' is not an array of 4"),
    "cut-off": (
        glb_textured(alphaMode="MASK", alphaCutoff="a").bytes(),
        "INVALID",
        "'alphaCutoff' is a, not a finite number",
    ),
}


def gltf(**buffer: Any) -> bytes:
    """Return the square as .gltf with a change to its buffer."""
    made = glb_square()
    text = json.loads(made.text())
    text["buffers"][0].update(buffer)
    return json.dumps(text).encode()


BAD_GLTFS: dict[str, tuple[bytes, str, str]] = {
    "empty": (b"", "INVALID", "the file is empty"),
    "a list": (b"[{}]", "INVALID", "it does not begin with '{'"),
    "cut off": (gltf()[:-1], "INVALID", "the JSON cannot be read"),
    "version": (b'{"asset": {"version": "1.1"}}', "UNSUPPORTED", "/asset/version: version 1.1 is not read"),
    "no uri": (json.dumps(glb_square().root).encode(), "INVALID", "names no other place"),
    "absent": (gltf(uri="absent.bin"), "INVALID", "/buffers/0/uri: it needs 'absent.bin' in its folder"),
    "absolute": (gltf(uri="/dev/zero"), "UNSUPPORTED", UNSEEN),
    "scheme": (gltf(uri="http://a/b.bin"), "UNSUPPORTED", "names a scheme"),
    "up": (gltf(uri="../a.bin"), "UNSUPPORTED", "leaves the folder"),
    "no data URI": (gltf(uri="#0"), "INVALID", "it needs '#0' in its folder"),
    "not base64": (gltf(uri="data:;base64," + "&" * 300), "INVALID", "the data is not base64"),
    "half a character": (gltf(uri="\ud800.bin"), "UNSUPPORTED", "is no name of a file"),
    "half a character of base64": (gltf(uri="data:;base64,\ud800"), "INVALID", "the data is not base64"),
    "short": (gltf(uri="data:;base64,AAAA"), "TRUNCATED", "it ends at byte 48 of a buffer of 3 bytes"),
    "no length": (gltf(byteLength=None), "INVALID", "'byteLength' is None"),
    "huge": (gltf(byteLength=2**50), "INVALID", "'byteLength' is 1125899906842624, not an integer"),
    "image": (glb_textured("../a.png").text(), "UNSUPPORTED", UNSEEN),
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
    "meshopt: mode": (packed(mode="TEXT"), "INVALID", "mode TEXT with filter NONE is not in the extension"),
    "meshopt: filter": (packed(filter=[]), "INVALID", "filter [] is not in the extension"),
    "meshopt: stride": (packed(byteStride=6), "INVALID", "4 elements of 6 bytes cannot be ATTRIBUTES"),
    "meshopt: triangles": (packed(mode="TRIANGLES", byteStride=4), "INVALID", "cannot be TRIANGLES"),
    "meshopt: filtered": (
        packed(mode="INDICES", byteStride=4, filter="OCTAHEDRAL"),
        "INVALID",
        "cannot be INDICES with filter OCTAHEDRAL",
    ),
    "meshopt: size": (packed(count=5), "INVALID", "5 elements of 12 bytes are not the 48 bytes of the view"),
    "meshopt: end": (packed(byteLength=99), "TRUNCATED", "it ends at byte 99 of a buffer of 60 bytes"),
    "draco: no positions": (draco({"NORMAL": 0}), "INVALID", "there is no POSITION among its attributes"),
    "draco: no count": (draco({"POSITION": 0}, count=None), "INVALID", "has no accessor with a 'count'"),
    "draco: huge": (draco({"POSITION": 0}, count=10**12), "TOO_LARGE", "its compressed arrays would take"),
    "draco: no id": (draco({"POSITION": "a"}), "INVALID", "'POSITION' is a, not an integer"),
}
