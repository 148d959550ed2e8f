"""Invalid mesh files by name, with their suffix, content and error code."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from msb.meshes import read_mesh
from tests.corpus.forge import png

from .builders import (
    OBJ_SQUARE,
    OFF_SQUARE,
    SMALL,
    SQUARE,
    XYZ,
    Glb,
    glb_file,
    glb_square,
    glb_textured,
    off,
    picture,
    ply,
    ply_floats,
    ply_square,
    ply_text,
    stl_binary,
    stl_facet,
    stl_text,
)


def changed(change: Callable[[dict[str, Any]], object]) -> bytes:
    """Return the square as GLB with a change to its JSON."""
    glb = glb_square()
    change(glb.root)
    return glb.bytes()


def with_first(table: str, **more: Any) -> bytes:
    """Return the square with a change to the first accessor, buffer view or node."""
    return changed(lambda root: root[table][0].update(more))


def with_primitive(**more: Any) -> bytes:
    return changed(lambda root: root["meshes"][0]["primitives"][0].update(more))


def sparse(replaced: list[int], base: dict[str, Any] | None = None, **more: Any) -> bytes:
    """Return the square with sparse positions. They replace rows of the stored positions or of `base`."""
    glb = glb_square()
    glb.root["accessors"][0] = base or glb.root["accessors"][0]
    places = {"bufferView": glb.view(np.array(replaced, "<u2").tobytes()), "componentType": 5123}
    values = {"bufferView": glb.view(ply_floats([[7, 7, 7]] * len(replaced)))}
    glb.root["accessors"][0]["sparse"] = {
        "count": len(replaced),
        "indices": places,
        "values": values,
        **more,
    }
    return glb.bytes()


def colors(count: int, dtype: str = "u1", kind: str = "VEC4") -> bytes:
    """Return the square with `count` colours of the given number type and element type."""
    glb = glb_square()
    width = int(kind[-1])
    number = glb.accessor(np.zeros((count, width)), dtype, kind)
    glb.root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = number
    return glb.bytes()


def many_primitives(count: int, nodes: int) -> bytes:
    """Return a mesh of many primitives that share a triangle, used by many nodes."""
    glb = Glb()
    position = glb.accessor(SQUARE[:3], "f4", "VEC3")
    for _ in range(count):
        glb.primitive(position)
    glb.root["nodes"] = [{"mesh": 0}] * nodes
    glb.root["scenes"] = [{"nodes": list(range(nodes))}]
    return glb.bytes()


def text_root(text: str) -> bytes:
    return glb_file(text.encode("utf-8"))


def resized(length: int) -> bytes:
    """Return the square as GLB with a wrong length in its header."""
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
    "huge count": (with_first("accessors", count=10**12), "TRUNCATED"),
    "position type": (with_first("accessors", type="VEC2"), "INVALID"),
    "stride": (with_first("bufferViews", byteStride=4), "INVALID"),
    "sparse index": (sparse([1, 4]), "INVALID"),
    "sparse, huge base": (
        sparse([0], {"componentType": 5126, "type": "VEC3", "count": 10**12}),
        "TOO_LARGE",
    ),
    "sparse values": (sparse([1, 2], values={"bufferView": 2}), "TRUNCATED"),
    "no accessor": (with_primitive(indices=9), "INVALID"),
    "no position": (with_primitive(attributes={}), "INVALID"),
    "mode": (with_primitive(mode=7), "INVALID"),
    "four corners": (glb_square(indices=[0, 1, 2, 3]).bytes(), "INVALID"),
    "color count": (colors(3), "INVALID"),
    "own child": (with_first("nodes", children=[0]), "INVALID"),
    "cycle without scene": (
        changed(
            lambda root: (root.pop("scenes"), root["nodes"].extend([{"children": [2]}, {"children": [1]}]))
        ),
        "INVALID",
    ),
    "nothing shown": (changed(lambda root: root["nodes"][0].clear()), "INVALID"),
    "infinite scale": (
        glb_file(
            json.dumps(glb_square().root).replace('"mesh": 0', '"mesh": 0, "scale": [1e999, 1, 1]').encode()
        ),
        "INVALID",
    ),
    "primitives times nodes": (many_primitives(1_000, 1_000), "TOO_LARGE"),
}


JPEG = picture(np.zeros((8, 8, 3), np.uint8), "JPEG")
# Images that cannot be read. A file with such an image is read without it.
BAD_IMAGES: dict[str, bytes | str] = {
    "file scheme": "file:///etc/passwd",
    "other folder": "../a.png",
    "absent": "absent.png",
    "backslash": "..\\a.png",
    "a folder": ".",
    "not base64": "data:image/png;base64,a$b",
    "cut off": picture()[:-30],
    "100,000 a side": png(100_000, 100_000),
    "many scans": JPEG[:-2] + b"\xff\xda" * 101 + JPEG[-2:],
}


def material(**more: Any) -> bytes:
    """Return the textured square with a change to its base colour."""
    glb = glb_textured()
    glb.root["materials"][0]["pbrMetallicRoughness"].update(more)
    return glb.bytes()


BAD_GLBS |= {
    "texture: none": (material(baseColorTexture={"index": 3}), "INVALID"),
    "cut-off": (glb_textured(alphaMode="MASK", alphaCutoff="a").bytes(), "INVALID"),
}


def gltf(**buffer: Any) -> bytes:
    """Return the square as .gltf with a change to its buffer."""
    glb = glb_square()
    text = json.loads(glb.text())
    text["buffers"][0].update(buffer)
    return json.dumps(text).encode()


BAD_GLTFS: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "INVALID"),
    "a list": (b"[{}]", "INVALID"),
    "version": (b'{"asset": {"version": "1.1"}}', "UNSUPPORTED"),
    "no uri": (json.dumps(glb_square().root).encode(), "INVALID"),
    "absent": (gltf(uri="absent.bin"), "INVALID"),
    "half a character of base64": (gltf(uri="data:;base64,\ud800"), "INVALID"),
    "short": (gltf(uri="data:;base64,AAAA"), "TRUNCATED"),
}


def packed(**more: Any) -> bytes:
    """Return the square with invalid vertex data that is marked as compressed by meshopt."""
    glb = glb_square()
    view = glb.root["bufferViews"][0]
    entry = {"buffer": 0, "byteLength": 12, "byteStride": 12, "count": 4, "mode": "ATTRIBUTES"}
    glb.root["buffers"].append({"byteLength": 48})
    glb.root["bufferViews"][0] = view | {
        "buffer": 1,
        "extensions": {"EXT_meshopt_compression": entry | more},
    }
    return glb.bytes()


def draco(attributes: dict[str, Any], **accessor: Any) -> bytes:
    """Return the square with invalid data that is marked as compressed by Draco."""
    glb = glb_square()
    for entry in glb.root["accessors"]:
        entry.pop("bufferView")
        entry.update(accessor)
    extension = {"bufferView": 0, "attributes": attributes}
    glb.root["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": extension}
    return glb.bytes()


BAD_GLBS |= {
    "meshopt: stride": (packed(byteStride=6), "INVALID"),
    "meshopt: size": (packed(count=5), "INVALID"),
    "meshopt: end": (packed(byteLength=99), "TRUNCATED"),
    "draco: no positions": (draco({"NORMAL": 0}), "INVALID"),
    "draco: huge": (draco({"POSITION": 0}, count=10**12), "TOO_LARGE"),
}


Bad = tuple[str, bytes, str]
LITTLE = "binary_little_endian"
VERTICES = ["element vertex 4", *XYZ]
BODY = ply_floats(SQUARE)
TEXT = OFF_SQUARE + b"3 0 1 2\n3 0 2 3\n"


def header(old: str, new: str, content: bytes | None = None) -> bytes:
    """Return a PLY file with one change in its header."""
    content = ply_text(TEXT) if content is None else content
    assert old.encode("ascii") in content
    return content.replace(old.encode("ascii"), new.encode("latin-1"), 1)


def row(old: bytes, new: bytes) -> bytes:
    """Return a text PLY with one change in its rows."""
    return ply_text(TEXT.replace(old, new))


def wide_list(body: bytes) -> bytes:
    """Return a binary PLY of one face whose number of corners is stored as an int."""
    return ply(LITTLE, [*VERTICES, "element face 1", "property list int int vertex_index"], body)


def vertex(line: bytes) -> bytes:
    """Return an OFF file of one vertex."""
    return off(b"OFF\n1 0 0", line)


def face(line: bytes) -> bytes:
    """Return an OFF file of one vertex and one face."""
    return off(b"OFF\n1 1 0", b"0 0 0\n", line)


def facet(corners: Sequence[str]) -> bytes:
    """Return a text STL of one face."""
    return stl_text(stl_facet(corners))


_PLY: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "INVALID"),
    "no end_header": (header("end_header", "end_heade"), "TRUNCATED"),
    "endless header": (b"ply\n" + b"comment x\n" * 200_000, "TOO_LARGE"),
    "no format": (header("format ascii 1.0\n", ""), "INVALID"),
    "unknown format": (header("ascii", "utf8"), "INVALID"),
    "type": (header("float x", "half x"), "INVALID"),
    "float list count": (header("list uchar", "list float"), "INVALID"),
    "float indices": (header("uchar int", "uchar float"), "INVALID"),
    "x is a list": (header("float x", "list uchar float x"), "INVALID"),
    "no vertex": (header("element vertex", "element vertices"), "INVALID"),
    "two x": (header("float y", "float x"), "INVALID"),
    "property first": (header("element vertex 4\n", ""), "INVALID"),
    "strips": (
        ply(LITTLE, [*VERTICES, "element tristrips 1", "property list int int vertex_indices"], BODY),
        "UNSUPPORTED",
    ),
    "text vertices missing": (ply_text(OFF_SQUARE), "TRUNCATED"),
    "text huge count": (header("vertex 4", "vertex 1000000000000"), "TRUNCATED"),
    "text word": (row(b"1 1 0", b"1 one 0"), "INVALID"),
    "text trailing": (ply_text(TEXT + b"\n7\n"), "INVALID"),
    "binary negative list": (wide_list(BODY + b"\xff" * 4), "INVALID"),
    "binary list in vertex": (
        ply(
            LITTLE, ["element vertex 2", *XYZ, "property list uchar uchar t"], b"\1" * 13 + b"\1" + b"\2" * 13
        ),
        "TRUNCATED",
    ),
    "binary trailing": (ply_square() + b"more", "INVALID"),
    "zero-size rows": (
        ply(LITTLE, ["element ghost 1000000000000", "element vertex 1000000", *XYZ], b""),
        "TRUNCATED",
    ),
}

_OBJ: dict[str, tuple[bytes, str]] = {
    "binary": (b"v 0 0 0\n\0\1\2", "INVALID"),
    "word": (b"# c\nv 0 zero 0\n", "INVALID"),
    "index before the first": (b"v 0 0 0\nf -1 -1 -2\n", "INVALID"),
    "index huge": (OBJ_SQUARE + b"f 1 99999999999999999999 3\n", "INVALID"),
    "shell": (OBJ_SQUARE + b"csh rm -rf x\n", "UNSUPPORTED"),
}

_OFF: dict[str, tuple[bytes, str]] = {
    "garbage": (b"4 2 0\n" + OFF_SQUARE, "INVALID"),
    "binary": (b"OFF BINARY\n\0\0\0\4", "UNSUPPORTED"),
    "4OFF": (b"4OFF\n1 0 0\n0 0 0 1\n", "UNSUPPORTED"),
    "nothing after OFF": (b"OFF\n# \n", "TRUNCATED"),
    "line missing": (off(b"OFF\n4 2 0", OFF_SQUARE, b"3 0 1 2    \n"), "TRUNCATED"),
    "line more": (off(b"OFF\n4 1 0", OFF_SQUARE, b"3 0 1 2\n3 0 2 3\n"), "INVALID"),
    "uneven vertices": (off(b"COFF\n2 0 0", b"0 0 0\n0 0 0 1 1 1\n"), "INVALID"),
    "word": (vertex(b"0 o 0\n"), "INVALID"),
    "huge corners": (face(b"1000000000 0\n"), "INVALID"),
    "index fraction": (face(b"3 0 0.5 0\n"), "INVALID"),
}

_STL: dict[str, tuple[bytes, str]] = {
    "garbage": (b"\x80\x02garbage", "INVALID"),
    "huge count": (stl_binary([SQUARE[:3]], count=2**32 - 1), "TRUNCATED"),
    "count 0 with faces": (stl_binary([SQUARE[:3]], count=0), "INVALID"),
    "cut in a face": (b"solid x\n" + stl_facet()[:-17], "TRUNCATED"),
    "two numbers": (facet(("0 0 0", "1 0", "0 1 0")), "INVALID"),
    "four corners": (facet(("0 0 0",) * 4), "INVALID"),
}

_GLTF = ((".glb", BAD_GLBS), (".gltf", BAD_GLTFS))
BAD: dict[str, Bad] = {
    f"{suffix[1:]}: {name}": (suffix, content, f"MESH_FILE_{code}")
    for suffix, table in ((".ply", _PLY), (".obj", _OBJ), (".off", _OFF), (".stl", _STL), *_GLTF)
    for name, (content, code) in table.items()
}
"""All invalid files."""


def read_case(name: str, root: Path) -> Any:
    """Write an invalid file to the folder `root`, and read it."""
    suffix, content, _ = BAD[name]
    path = root / f"bad{suffix}"
    path.write_bytes(content)
    return read_mesh(path)
