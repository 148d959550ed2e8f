"""Mesh files that are not valid: name -> suffix, content, code, and a piece of the message."""

from __future__ import annotations

from collections.abc import Sequence

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

Bad = tuple[str, bytes, str, str]
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


_PLY: dict[str, tuple[bytes, str, str]] = {
    "empty": (b"", "INVALID", "the file is empty"),
    "garbage": (b"\x80\x02garbage", "INVALID", "it does not begin with a line 'ply'"),
    "first line": (b"plywood\n", "INVALID", "it does not begin with a line 'ply'"),
    "no end_header": (header("end_header", "end_heade"), "TRUNCATED", "ends before 'end_header'"),
    "endless header": (b"ply\n" + b"comment x\n" * 200_000, "TOO_LARGE", "within 1048576 bytes"),
    "no format": (header("format ascii 1.0\n", ""), "INVALID", "no line 'format ascii 1.0'"),
    "two formats": (header("element vertex", "format ascii 1.0\nelement vertex"), "INVALID", "wrong place"),
    "unknown format": (header("ascii", "utf8"), "INVALID", "line 2: format 'utf8' is unknown"),
    "version": (header("1.0", "2.0"), "UNSUPPORTED", "version '2.0'"),
    "keyword": (header("property float x", "propperty float x"), "INVALID", "line 4: 'propperty float x'"),
    "type": (header("float x", "half x"), "INVALID", "line 4: 'half' is not a type"),
    "property words": (header("float x", "float x y"), "INVALID", "'property TYPE NAME'"),
    "float list count": (
        header("list uchar", "list float"),
        "INVALID",
        "count of list 'vertex_indices' is float",
    ),
    "float indices": (header("uchar int", "uchar float"), "INVALID", "no list of integers 'vertex_indices'"),
    "indices no list": (header("list uchar int", "int"), "INVALID", "no list of integers 'vertex_indices'"),
    "x is a list": (header("float x", "list uchar float x"), "INVALID", "no property 'x' that is one number"),
    "no z": (header("property float z\n", ""), "INVALID", "no property 'z'"),
    "no vertex": (header("element vertex", "element vertices"), "INVALID", "no element 'vertex'"),
    "two x": (header("float y", "float x"), "INVALID", "property 'x' of element 'vertex' is declared twice"),
    "two vertex": (header("element face", "element vertex"), "INVALID", "element 'vertex' is declared twice"),
    "property first": (header("element vertex 4\n", ""), "INVALID", "line 3: 'property float x'"),
    "negative count": (header("vertex 4", "vertex -4"), "INVALID", "count '-4', not a whole number"),
    "long count": (header("vertex 4", "vertex " + "9" * 5000), "INVALID", "not a whole number"),
    "strips": (
        ply(LITTLE, [*VERTICES, "element tristrips 1", "property list int int vertex_indices"], BODY),
        "UNSUPPORTED",
        "'tristrips'",
    ),
    "text vertices missing": (ply_text(OFF_SQUARE), "TRUNCATED", "declares 6 rows, but 4 lines follow"),
    "text huge count": (header("vertex 4", "vertex 1000000000000"), "TRUNCATED", "1000000000002 rows"),
    "text short row": (row(b"1 1 0", b"1 1"), "INVALID", "row 2 of element 'vertex' has 2"),
    "text long row": (row(b"1 1 0", b"1 1 0 0"), "INVALID", "line 12: row 2 of element 'vertex'"),
    "text word": (row(b"1 1 0", b"1 one 0"), "INVALID", "line 12: 'one' is not a number"),
    "text hexadecimal": (row(b"1 1 0", b"1 0x1 0"), "INVALID", "'0x1' is not a number"),
    "text glued": (row(b"1 1 0", b"1 1-0"), "INVALID", "'1-0' is not a number"),
    "text comma": (row(b"1 1 0", b"1,5 1 0"), "INVALID", "'1,5' is not a number"),
    "text face short": (row(b"3 0 2 3", b"4 0 2 3"), "INVALID", "line 15: row 1 of element 'face'"),
    "text face long": (row(b"3 0 2 3", b"2 0 2 3"), "INVALID", "row 1 of element 'face'"),
    "text face huge": (row(b"3 0 2 3", b"1e18 0 2 3"), "INVALID", "row 1 of element 'face'"),
    "text face negative": (row(b"3 0 2 3", b"-3 0 2 3"), "INVALID", "row 1 of element 'face'"),
    "text face nan": (row(b"3 0 2 3", b"nan 0 2 3"), "INVALID", "row 1 of element 'face'"),
    "text index fraction": (row(b"3 0 2 3", b"3 0 2.5 3"), "INVALID", "line 15: an index is 2.5"),
    "text index nan": (row(b"3 0 2 3", b"3 0 nan 3"), "INVALID", "an index is nan"),
    "text index huge": (row(b"3 0 2 3", b"3 0 1e99 3"), "INVALID", "an index is 1e+99"),
    "text trailing": (ply_text(TEXT + b"\n7\n"), "INVALID", "line 17: there is more"),
    "text nul": (ply_text(TEXT + b"\0"), "INVALID", "is NUL"),
    "binary short": (ply_square()[:-1], "TRUNCATED", "within row 1 of the 2 rows of element 'face'"),
    "binary no faces": (
        ply_square()[:-26],
        "TRUNCATED",
        "element 'face' declares 2 rows of at least 1 bytes",
    ),
    "binary huge count": (
        header("vertex 4", "vertex 1000000000000", ply_square()),
        "TRUNCATED",
        "declares 1000000000000 rows of at least 12 bytes",
    ),
    "binary huge list": (wide_list(BODY + b"\xff\xff\xff\x7f"), "TRUNCATED", "within row 0"),
    "binary negative list": (
        wide_list(BODY + b"\xff" * 4),
        "INVALID",
        "row 0 of element 'face' has a list of -1 values",
    ),
    "binary list in vertex": (
        ply(
            LITTLE, ["element vertex 2", *XYZ, "property list uchar uchar t"], b"\1" * 13 + b"\1" + b"\2" * 13
        ),
        "TRUNCATED",
        "within row 1 of the 2 rows of element 'vertex'",
    ),
    "binary trailing": (ply_square() + b"more", "INVALID", "4 bytes follow the last declared row"),
    "huge name": (
        ply(LITTLE, [*VERTICES, f"element {'x' * 100_000} 1", "property int a"], BODY),
        "TRUNCATED",
        "xxx...' declares 1 rows",
    ),
    "zero-size rows": (
        ply(LITTLE, ["element ghost 1000000000000", "element vertex 1000000", *XYZ], b""),
        "TRUNCATED",
        "1000000 rows of at least 12 bytes",
    ),
}

_OBJ: dict[str, tuple[bytes, str, str]] = {
    "empty": (b"", "INVALID", "the file is empty"),
    "garbage": (b"\x80\x02garbage\n", "INVALID", "it has no 'v x y z' line"),
    "binary": (b"v 0 0 0\n\0\1\2", "INVALID", "byte 8 is NUL"),
    "html": (b"<html><body>404</body></html>\n", "INVALID", "it has no 'v x y z' line"),
    "only faces": (b"f 1 2 3\n", "INVALID", "it has no 'v x y z' line"),
    "two numbers": (b"v 0 0 0\nv 1 1\n", "INVALID", "line 2: 'v' has 2 numbers"),
    "five numbers": (b"v 0 0 0 1 1\n", "INVALID", "'v' has 5 numbers"),
    "eight numbers": (b"v 0 0 0 1 1 1 1 1\n", "INVALID", "'v' has 8 numbers"),
    "no numbers": (b"v\n", "INVALID", "'v' has 0 numbers"),
    "word": (b"# c\nv 0 zero 0\n", "INVALID", "line 2: 'zero' is not a number"),
    "underscore": (b"v 1_0 0 0\n", "INVALID", "'1_0' is not a number"),
    "escape": (b"v 1 \x1b[31m 0\n", "INVALID", "'\\x1b[31m' is not a number"),
    "long word": (b"v 0 0 " + b"x" * 10000 + b"\n", "INVALID", "xxx...' is not a number"),
    "index 0": (OBJ_SQUARE + b"f 1 2 3\nf 0 2 3\n", "INVALID", "line 6: index 0 is not allowed"),
    "index before the first": (b"v 0 0 0\nf -1 -1 -2\n", "INVALID", "line 2: index -2 is not allowed"),
    "index fraction": (OBJ_SQUARE + b"f 1 2.5 3\n", "INVALID", "line 5: index 2.5 is not"),
    "index nan": (OBJ_SQUARE + b"f 1 nan 3\n", "INVALID", "index nan is not"),
    "index huge": (OBJ_SQUARE + b"f 1 99999999999999999999 3\n", "INVALID", "index 1e+20 is not"),
    "index missing": (OBJ_SQUARE + b"f 1 /2 3\n", "INVALID", "line 5: '' is not a number"),
    "index word": (OBJ_SQUARE + b"f 1 two 3\n", "INVALID", "line 5: 'two' is not a number"),
    "after a continuation": (OBJ_SQUARE + b"f 1 2 \\\n x\n", "INVALID", "line 6: 'x' is not a number"),
    "surface": (OBJ_SQUARE + b"surf 0 1 0 1 1 2 3 4\n", "UNSUPPORTED", "line 5: 'surf' is not read"),
    "call": (b"call /etc/passwd\n" + OBJ_SQUARE, "UNSUPPORTED", "line 1: 'call' is not read"),
    "shell": (OBJ_SQUARE + b"csh rm -rf x\n", "UNSUPPORTED", "'csh' is not read"),
}

_OFF: dict[str, tuple[bytes, str, str]] = {
    "empty": (b"", "INVALID", "the file is empty"),
    "garbage": (b"4 2 0\n" + OFF_SQUARE, "INVALID", "does not begin with OFF"),
    "only comments": (b"# OFF\n\n", "INVALID", "does not begin with OFF"),
    "binary": (b"OFF BINARY\n\0\0\0\4", "UNSUPPORTED", "OFF BINARY is not read"),
    "4OFF": (b"4OFF\n1 0 0\n0 0 0 1\n", "UNSUPPORTED", "4OFF has vertices of other than three dimensions"),
    "STCN4nOFF": (b"STCN4nOFF\n3\n1 0 0\n", "UNSUPPORTED", "STCN4nOFF has"),
    "nothing after OFF": (b"OFF\n# \n", "TRUNCATED", "ends before the counts"),
    "counts": (b"OFF\nfour 2 0\n", "INVALID", "line 2: the counts are 'four 2 0'"),
    "one count": (b"OFF 4\n" + OFF_SQUARE, "INVALID", "line 1: the counts are '4'"),
    "negative counts": (b"OFF\n4 -2 0\n", "INVALID", "the counts are '4 -2 0'"),
    "huge vertices": (b"OFF\n1000000000000 0 0\n0 0 0\n", "TRUNCATED", "1000000000000 vertices and 0 faces"),
    "huge faces": (b"OFF\n1 999999999999 0\n0 0 0\n", "TRUNCATED", "1 vertices and 999999999999 faces"),
    "line missing": (off(b"OFF\n4 2 0", OFF_SQUARE, b"3 0 1 2    \n"), "TRUNCATED", "but has 5 lines"),
    "line more": (off(b"OFF\n4 1 0", OFF_SQUARE, b"3 0 1 2\n3 0 2 3\n"), "INVALID", "line 8: there is more"),
    "short vertex": (vertex(b"0  0   \n"), "INVALID", "line 3: a vertex has 2 numbers; 3, the same"),
    "colors without C": (vertex(b"0 0 0 1 1 1\n"), "INVALID", "a vertex has 6 numbers; 3, the same"),
    "normals without N": (
        off(b"COFF\n1 0 0", b"0 0 0 1 1\n"),
        "INVALID",
        "a vertex has 5 numbers; 3 or 6 or 7",
    ),
    "uneven vertices": (off(b"COFF\n2 0 0", b"0 0 0\n0 0 0 1 1 1\n"), "INVALID", "line 4: a vertex has 6"),
    "word": (vertex(b"0 o 0\n"), "INVALID", "line 3: 'o' is not a number"),
    "few corners": (face(b"3 0 0\n"), "INVALID", "line 4: face 0 announces 3 corners"),
    "five extra": (face(b"1 0 1 2 3 4 5\n"), "INVALID", "6 numbers follow"),
    "two extra": (face(b"1 0 1 2\n"), "INVALID", "3 numbers follow"),
    "negative corners": (face(b"-1 0 0\n"), "INVALID", "announces -1 corners"),
    "huge corners": (face(b"1000000000 0\n"), "INVALID", "announces 1000000000 corners"),
    "fraction of corners": (face(b"2.5 0 0\n"), "INVALID", "number of corners is 2.5"),
    "index fraction": (face(b"3 0 0.5 0\n"), "INVALID", "line 4: an index is 0.5"),
}

_STL: dict[str, tuple[bytes, str, str]] = {
    "empty": (b"", "INVALID", "the file is empty"),
    "garbage": (b"\x80\x02garbage", "INVALID", "it has 9 bytes; binary has at least 84"),
    "short": (
        stl_binary([SQUARE[:3]])[:-1],
        "TRUNCATED",
        "declares 1 faces, which take 134 bytes; it has 133",
    ),
    "short solid": (stl_binary([SQUARE[:3]], header=b"solid")[:-1], "TRUNCATED", "which take 134 bytes"),
    "huge count": (stl_binary([SQUARE[:3]], count=2**32 - 1), "TRUNCATED", "declares 4294967295 faces"),
    "trailing": (stl_binary([SQUARE[:3]]) + b"\0", "INVALID", "end at byte 134; it has 135 bytes"),
    "count 0 with faces": (stl_binary([SQUARE[:3]], count=0), "INVALID", "end at byte 84"),
    "no endsolid": (b"solid x\n" + stl_facet(), "TRUNCATED", "line 8: the file ends without 'endsolid'"),
    "only solid": (b"solid", "TRUNCATED", "ends without 'endsolid'"),
    "cut in a face": (b"solid x\n" + stl_facet()[:-17], "TRUNCATED", "ends without 'endsolid'"),
    "word": (facet(("0 0 0", "1 x 0", "0 1 0")), "INVALID", "line 5: 'x' is not a number"),
    "two numbers": (facet(("0 0 0", "1 0", "0 1 0")), "INVALID", "line 5: 'vertex' has 2 numbers"),
    "four corners": (facet(("0 0 0",) * 4), "INVALID", "line 7: a line that begins with 'endloop'"),
    "two corners": (facet(("0 0 0",) * 2), "INVALID", "line 6: a line that begins with 'vertex'"),
    "no loop": (
        stl_text(stl_facet().replace(b"outer loop\n", b"")),
        "INVALID",
        "line 3: a line that begins with 'outer'",
    ),
    "end in a face": (stl_text(stl_facet()[:-9]), "INVALID", "line 8: a line that begins with 'endfacet'"),
    "unknown line": (
        stl_text(stl_facet(), b"color 1 0 0\n"),
        "INVALID",
        "line 9: a line that begins with 'facet'",
    ),
}

_GLTF = ((".glb", BAD_GLBS), (".gltf", BAD_GLTFS))
BAD: dict[str, Bad] = {
    f"{suffix[1:]}: {name}": (suffix, content, f"MESH_FILE_{code}", message)
    for suffix, table in ((".ply", _PLY), (".obj", _OBJ), (".off", _OFF), (".stl", _STL), *_GLTF)
    for name, (content, code, message) in table.items()
}
"""All of them."""
