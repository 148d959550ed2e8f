"""Mesh files that are not valid: name -> suffix, content and code."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msb.meshes import read_mesh

from .bad_glbs import BAD_GLBS, BAD_GLTFS
from .builders import (
    OBJ_SQUARE,
    OFF_SQUARE,
    SQUARE,
    XYZ,
    off,
    ply,
    ply_floats,
    ply_square,
    ply_text,
    stl_binary,
    stl_facet,
    stl_text,
)

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
    """Return a binary PLY of one face, whose count of corners is an int."""
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
    "garbage": (b"\x80\x02garbage", "INVALID"),
    "no end_header": (header("end_header", "end_heade"), "TRUNCATED"),
    "endless header": (b"ply\n" + b"comment x\n" * 200_000, "TOO_LARGE"),
    "no format": (header("format ascii 1.0\n", ""), "INVALID"),
    "unknown format": (header("ascii", "utf8"), "INVALID"),
    "version": (header("1.0", "2.0"), "UNSUPPORTED"),
    "type": (header("float x", "half x"), "INVALID"),
    "property words": (header("float x", "float x y"), "INVALID"),
    "float list count": (header("list uchar", "list float"), "INVALID"),
    "float indices": (header("uchar int", "uchar float"), "INVALID"),
    "x is a list": (header("float x", "list uchar float x"), "INVALID"),
    "no vertex": (header("element vertex", "element vertices"), "INVALID"),
    "two x": (header("float y", "float x"), "INVALID"),
    "two vertex": (header("element face", "element vertex"), "INVALID"),
    "property first": (header("element vertex 4\n", ""), "INVALID"),
    "long count": (header("vertex 4", "vertex " + "9" * 5000), "INVALID"),
    "strips": (
        ply(LITTLE, [*VERTICES, "element tristrips 1", "property list int int vertex_indices"], BODY),
        "UNSUPPORTED",
    ),
    "text vertices missing": (ply_text(OFF_SQUARE), "TRUNCATED"),
    "text huge count": (header("vertex 4", "vertex 1000000000000"), "TRUNCATED"),
    "text short row": (row(b"1 1 0", b"1 1"), "INVALID"),
    "text word": (row(b"1 1 0", b"1 one 0"), "INVALID"),
    "text index huge": (row(b"3 0 2 3", b"3 0 1e99 3"), "INVALID"),
    "text trailing": (ply_text(TEXT + b"\n7\n"), "INVALID"),
    "text nul": (ply_text(TEXT + b"\0"), "INVALID"),
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
    "garbage": (b"\x80\x02garbage\n", "INVALID"),
    "binary": (b"v 0 0 0\n\0\1\2", "INVALID"),
    "two numbers": (b"v 0 0 0\nv 1 1\n", "INVALID"),
    "word": (b"# c\nv 0 zero 0\n", "INVALID"),
    "index before the first": (b"v 0 0 0\nf -1 -1 -2\n", "INVALID"),
    "index huge": (OBJ_SQUARE + b"f 1 99999999999999999999 3\n", "INVALID"),
    "index missing": (OBJ_SQUARE + b"f 1 /2 3\n", "INVALID"),
    "shell": (OBJ_SQUARE + b"csh rm -rf x\n", "UNSUPPORTED"),
}

_OFF: dict[str, tuple[bytes, str]] = {
    "garbage": (b"4 2 0\n" + OFF_SQUARE, "INVALID"),
    "binary": (b"OFF BINARY\n\0\0\0\4", "UNSUPPORTED"),
    "4OFF": (b"4OFF\n1 0 0\n0 0 0 1\n", "UNSUPPORTED"),
    "nothing after OFF": (b"OFF\n# \n", "TRUNCATED"),
    "negative counts": (b"OFF\n4 -2 0\n", "INVALID"),
    "huge faces": (b"OFF\n1 999999999999 0\n0 0 0\n", "TRUNCATED"),
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
    "word": (facet(("0 0 0", "1 x 0", "0 1 0")), "INVALID"),
    "two numbers": (facet(("0 0 0", "1 0", "0 1 0")), "INVALID"),
    "four corners": (facet(("0 0 0",) * 4), "INVALID"),
}

_GLTF = ((".glb", BAD_GLBS), (".gltf", BAD_GLTFS))
BAD: dict[str, Bad] = {
    f"{suffix[1:]}: {name}": (suffix, content, f"MESH_FILE_{code}")
    for suffix, table in ((".ply", _PLY), (".obj", _OBJ), (".off", _OFF), (".stl", _STL), *_GLTF)
    for name, (content, code) in table.items()
}
"""All of them."""


def read_case(name: str, root: Path) -> Any:
    """Write one of them below `root`, and read it."""
    suffix, content, _ = BAD[name]
    path = root / f"bad{suffix}"
    path.write_bytes(content)
    return read_mesh(path)
