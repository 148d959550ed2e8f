"""The STL format: separate triangles, binary or as text.

Each face has three separate vertices, which are not merged.
"""

import re
import struct
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.base.origin import NO_ORIGIN, find_origin, to_local
from msb.meshes.formats import Format, Style
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source
from msb.meshes.text import Words, word_blocks
from msb.meshes.writing import ROWS_AT_A_TIME, as_float32

_HEADER_BYTES = 84
# Bytes of one face in a binary file.
_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

# The first words of the lines of a face, in order.
_LINES = (b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet")

_KEYWORDS = (b"facet", b"outer", b"vertex", b"endloop", b"endfacet", b"solid", b"endsolid")
_CODES = {keyword: code for code, keyword in enumerate(_KEYWORDS, start=1)}
_FACE_CODES = [_CODES[keyword] for keyword in _LINES]


def read(source: Source) -> Mesh:
    """Read a binary or text STL file. Several solids are concatenated. Normals and attributes are ignored.

    Vertices of text files are also float32, unless they need an origin. With float64, the areas of published
    files would change by 2e-8. The mesh has 3F vertices, and the faces are (0, 1, 2), (3, 4, 5), and so on.
    """
    data = source.data
    declared = struct.unpack_from("<I", data, 80)[0] if len(data) >= _HEADER_BYTES else 0
    size = _HEADER_BYTES + _FACE.itemsize * declared
    if len(data) == size:
        return _make_soup(np.frombuffer(data, _FACE, declared, _HEADER_BYTES)["corners"])
    like = source.looks_like()
    if like is FORMAT and b"\0" not in data:
        return _make_soup(_read_text(source.as_text("STL")))
    if len(data) < _HEADER_BYTES or like not in (FORMAT, None):
        text = f"it has {len(data)} bytes and does not begin with 'solid'; binary files have at least "
        text += f"{_HEADER_BYTES} bytes"
        raise source.not_a("STL", text)
    code = "MESH_FILE_TRUNCATED" if len(data) < size else "MESH_FILE_INVALID"
    text = f"the header declares {declared} faces, which take {size} bytes; the file has {len(data)} bytes"
    raise source.error(code, text, pointer="byte 80")


def write(mesh: Mesh, stream: BinaryIO, _style: Style) -> None:
    """Write binary STL: the float32 corners and the normal of every face, without colours.

    Unused vertices are lost. The normal of a face without area is zero.
    """
    vertices = as_float32(mesh.vertices, "STL")
    stream.write(struct.pack("<80xI", len(mesh.faces)))
    for start in range(0, len(mesh.faces), ROWS_AT_A_TIME):
        corners = vertices[mesh.faces[start : start + ROWS_AT_A_TIME]]
        sides = np.diff(corners.astype(np.float64), axis=1)
        normals = np.cross(sides[:, 0], sides[:, 1])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        records = np.zeros(len(corners), _FACE)
        records["corners"] = corners
        np.divide(normals, length, out=records["normal"], where=length > 0, casting="same_kind")
        stream.write(records.tobytes())


def _make_soup(corners: NDArray[Any]) -> Mesh:
    """Return a mesh of consecutive `corners` (3F, 3) or (F, 3, 3), with three corners per face."""
    rows = np.ascontiguousarray(corners).reshape(-1, 3)
    return Mesh(rows, np.arange(len(rows)).reshape(-1, 3))


def _read_text(text: Source) -> NDArray[Any]:
    """Return the corners (3F, 3) of a text file."""
    corners, codes, places = [np.zeros((0, 3))], [], []
    for words in word_blocks(Source(text.path, text.data.lower())):
        code = _classify_lines(words)
        corners.append(_read_vertices(words, code == _CODES[b"vertex"]))
        codes.append(code)
        places.append(words.base + words.start[words.first])
    _check_order(text, np.concatenate(codes), np.concatenate(places))
    rows = np.concatenate(corners)
    return rows if any(find_origin(rows)) else to_local(rows, NO_ORIGIN)


def _classify_lines(words: Words) -> NDArray[np.uint8]:
    """Return a keyword code for each line (L,). The code depends on the first word of the line. The code is 0
    if the word is not a keyword."""
    codes = np.zeros(len(words.first), dtype=np.uint8)
    for keyword, code in _CODES.items():
        codes[words.lines_beginning(keyword)] = code
    return codes


def _read_vertices(words: Words, is_vertex: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the coordinates (N, 3) of the lines selected by `is_vertex` (L,)."""
    wrong = np.flatnonzero(is_vertex & (words.count != 4))
    if wrong.size:
        numbers = int(words.count[wrong[0]]) - 1
        text = f"'vertex' has {numbers} numbers; it must have three"
        raise words.line_error("MESH_FILE_INVALID", int(wrong[0]), text)
    return words.numbers(words.arguments(is_vertex)).reshape(-1, 3)


def _check_order(text: Source, codes: NDArray[np.uint8], places: NDArray[np.int64]) -> None:
    """Raise an error if a face is incomplete, or if "solid" or "endsolid" interrupts a face.

    The argument `codes` (L,) has the codes of the lines' first words. The argument `places` (L,) has the byte
    offsets of the lines.
    """
    between = codes >= _CODES[b"solid"]
    # Except for "solid" and "endsolid" lines, every face must consist of these lines in this order.
    in_faces = np.flatnonzero(~between)
    expected = np.resize(_FACE_CODES, len(in_faces))
    wrong = in_faces[codes[in_faces] != expected]
    # A line "solid" or "endsolid" must not interrupt a face.
    inside = np.flatnonzero(between & (np.cumsum(~between) % len(_LINES) != 0))
    if wrong.size or inside.size:
        line = int(min(wrong[:1].tolist() + inside[:1].tolist()))
        keyword = _LINES[int(np.count_nonzero(~between[:line])) % len(_LINES)].decode()
        message = f"a line that begins with '{keyword}' is expected here; a face has the lines "
        message += ", ".join(word.decode() for word in _LINES)
        raise text.line_error("MESH_FILE_INVALID", int(places[line]), message)
    if codes[-1] != _CODES[b"endsolid"]:
        raise text.line_error("MESH_FILE_TRUNCATED", int(places[-1]), "the file ends without 'endsolid'")


# Signature of STL text files. Binary files have no signature.
_BEGINS = re.compile(rb"\s*+solid\b", re.IGNORECASE)
FORMAT = Format("STL", (".stl",), read, write, begins=_BEGINS, is_soup=True, is_single=True)
