"""OFF: the Object File Format of Geomview as text, with its variants for colours, normals and UVs."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.base.seam_keys import hash_attributes
from msb.errors import shorten
from msb.meshes.colors import stored_colors
from msb.meshes.formats import Format, Style
from msb.meshes.mesh import Mesh
from msb.meshes.polygons import Triangulation, concatenate_ranges, find_wrong_polygon, triangulate
from msb.meshes.source import Source
from msb.meshes.text import Table, read_table
from msb.meshes.writing import write_rows

_KEYWORD = re.compile(rb"((?:ST|[CN4n]){0,5})OFF(.*)")
_BINARY = re.compile(rb"\s*+\w{0,6}OFF[ \t]+BINARY", re.IGNORECASE)
_PREFIXES = re.compile(r"ST|C|N|4|n")
_COUNTS = re.compile(rb"\s*(\d{1,18})\s+(\d{1,18})(?:\s+[+-]?\d+)?\s*")
_LINE = re.compile(rb"[^\n]*\n?")


@dataclass(frozen=True)
class _Header:
    """The parsed header. The field `body` is the offset of the first byte after the header."""

    prefixes: frozenset[str]
    vertices: int
    faces: int
    body: int


# Names of unread vertex data, by the prefix of "OFF" that declares the data.
_LEFT_OUT = {"N": "normals", "ST": "UVs"}


def read(source: Source) -> Mesh:
    """Read an OFF file with any of the prefixes ST, C and N. Vertices are float64.

    A COFF file may have colours at its faces instead of its vertices. The exporter of Triangle-Splatting
    writes COFF files with face colours. Face colours are kept if all faces have the same number of channels.
    """
    if _BINARY.match(source.data):
        raise source.error("MESH_FILE_UNSUPPORTED", "binary OFF is not supported; save the file as text")
    text = source.as_text("OFF")
    header = _read_header(text)
    room = len(text.data) - header.body + 1
    if header.vertices * len("0 0 0\n") + header.faces * len("0\n") > room:
        declared = f"{header.vertices} vertices and {header.faces} faces"
        raise source.error("MESH_FILE_TRUNCATED", f"the file is too short for {declared}")
    table = read_table(text, header.body, comments=True)
    rows, declared_rows = len(table.byte), header.vertices + header.faces
    if rows < declared_rows:
        missing = f"the header declares {header.vertices} vertices and {header.faces} faces, but only {rows} "
        raise source.error("MESH_FILE_TRUNCATED", missing + "lines follow")
    if rows > declared_rows:
        raise table.row_error("MESH_FILE_INVALID", declared_rows, "lines follow after the last face")
    vertices, vertex_colors = _read_vertices(table, header)
    faces, cut, face_colors = _read_faces(table, header, vertices)
    wrong = find_wrong_polygon(faces, cut.polygon, header.vertices)
    wrong_face = None
    if wrong is not None:
        byte = int(table.byte[header.vertices + wrong[0]])
        wrong_face = text.wrong_index(byte, wrong[1], header.vertices)
    left_out = [what for prefix, what in _LEFT_OUT.items() if prefix in header.prefixes]
    return Mesh(
        vertices,
        faces,
        vertex_colors,
        face_colors,
        vertex_keys=_hash_unread(table, header),
        left_out=(*left_out, *cut.left_out),
        wrong_face=wrong_face,
    )


def _hash_unread(table: Table, header: _Header) -> NDArray[np.uint32] | None:
    """Return the seam keys (V,) from normals and texture coordinates. Return None if a file has neither."""
    before, after = 3 * ("N" in header.prefixes), 2 * ("ST" in header.prefixes)
    if not (before or after) or not header.vertices:
        return None
    begin, end = table.row[: header.vertices], table.row[1 : header.vertices + 1]
    places = [begin + 3 + number for number in range(before)] + [end - 1 - number for number in range(after)]
    return hash_attributes(table.values[place] for place in places)


def write(mesh: Mesh, stream: BinaryIO, _style: Style) -> None:
    """Write an OFF file, or a COFF file if vertices have colours.

    Face colours follow the vertex indices of a face.

    Coordinates are exact when the file is read again. Colours of type uint8 are written as integers, and
    float32 colours as decimals.
    """
    keyword = "OFF" if mesh.vertex_colors is None else "COFF"
    stream.write(f"{keyword}\n{len(mesh.vertices)} {len(mesh.faces)} 0\n".encode("ascii"))
    write_rows(stream, *_append_colors("%r %r %r", mesh.vertices, mesh.vertex_colors))
    write_rows(stream, *_append_colors("3 %d %d %d", mesh.faces, mesh.face_colors))


def _append_colors(form: str, columns: NDArray[Any], colors: NDArray[Any] | None) -> tuple[str, NDArray[Any]]:
    """Append `colors` (N, 3 | 4) to the line format and to the columns (N, K).

    Return the format and the columns.
    """
    if colors is None:
        return form, columns
    conversion = " %d" if colors.dtype == np.uint8 else " %r"
    return form + conversion * colors.shape[1], np.column_stack((columns, colors))


def _split_lines(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield each non-blank line without its comment, and the byte offset after the line."""
    for line in _LINE.finditer(data):
        content = line[0].partition(b"#")[0].strip()
        if content:
            yield content, line.end()


def _read_header(text: Source) -> _Header:
    """Read the keyword and the counts of the header. The counts are on the same line or on the next line."""
    lines = _split_lines(text.data)
    content, end = next(lines, (b"", 0))
    prefixes, words = _read_keyword(text, content)
    if not words:
        words, end = next(lines, (b"", end))
    if not words:
        raise text.error("MESH_FILE_TRUNCATED", "the file ends before the counts of vertices and faces")
    counts = _COUNTS.fullmatch(words)
    if counts is None:
        message = f"the counts are '{shorten(words.decode('latin-1'))}'; "
        message += "the counts must be 'VERTICES FACES EDGES', as non-negative whole numbers"
        raise text.line_error("MESH_FILE_INVALID", end - 1, message)
    return _Header(prefixes, int(counts[1]), int(counts[2]), end)


def _read_keyword(text: Source, content: bytes) -> tuple[frozenset[str], bytes]:
    """Return the prefixes in the keyword of the first line, such as "C" in COFF. Also return the text after
    the keyword."""
    keyword = _KEYWORD.fullmatch(content)
    if keyword is None:
        raise text.not_a("OFF", "the first word is not OFF, COFF, NOFF or STOFF")
    prefixes = frozenset(_PREFIXES.findall(keyword[1].decode("ascii")))
    if prefixes & {"4", "n"}:
        name = keyword[1].decode("ascii") + "OFF"
        message = f"{name} files have vertices that are not three-dimensional, which is not supported"
        raise text.error("MESH_FILE_UNSUPPORTED", message)
    return prefixes, keyword[2].strip()


def _read_vertices(table: Table, header: _Header) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
    """Return the vertices (V, 3) and their colours. Without colours, the second value is None.

    A line contains the position, then the optional normal, colour and texture coordinates.
    """
    V = header.vertices
    begin = table.row[:V]
    widths = np.diff(table.row[: V + 1])
    plain = 3 + 3 * ("N" in header.prefixes) + 2 * ("ST" in header.prefixes)
    allowed = (plain, plain + 3, plain + 4) if "C" in header.prefixes else (plain,)
    width = int(widths[0]) if V else plain
    wrong = np.flatnonzero(widths != (width if width in allowed else -1))
    if wrong.size:
        numbers = int(widths[wrong[0]])
        valid = " or ".join(str(count) for count in allowed)
        message = f"a vertex has {numbers} numbers; all vertices must have {valid}"
        raise table.row_error("MESH_FILE_INVALID", int(wrong[0]), message)
    vertices = table.values[begin[:, None] + np.arange(3)]
    if width == plain:
        return vertices, None
    color_begin = begin + 3 + 3 * ("N" in header.prefixes)
    return vertices, _read_colors(table, color_begin[:, None] + np.arange(width - plain))


def _read_faces(
    table: Table, header: _Header, vertices: NDArray[np.float64]
) -> tuple[NDArray[np.int64], Triangulation, NDArray[Any] | None]:
    """Return the triangles (F, 3), the triangulation of the polygons, and the colours (F, 3 | 4) or None.

    A face line has the number of corners, their vertex indices, and an optional colour.
    """
    begin = table.row[header.vertices : -1]
    counts = table.integers(begin, "the number of corners")
    extra = np.diff(table.row[header.vertices :]) - 1 - counts
    wrong = np.flatnonzero((counts < 0) | ~np.isin(extra, (0, 1, 3, 4)))
    if wrong.size:
        face = int(wrong[0])
        message = (
            f"face {face} declares {counts[face]} corners, but {counts[face] + extra[face]} values follow; "
        )
        message += "after the corners, only a colour of 1, 3 or 4 values may follow"
        raise table.row_error("MESH_FILE_INVALID", header.vertices + face, message)
    corners = table.integers(np.repeat(begin + 1, counts) + concatenate_ranges(counts), "an index")
    cut = triangulate(vertices, corners, counts)
    faces = corners[cut.order]
    # Colours are read if all faces with triangles have the same number of channels, 3 or 4.
    drawn = counts >= 3
    width = int(extra[drawn][0]) if drawn.any() else 0
    if width < 3 or (extra[drawn] != width).any():
        return faces, cut, None
    places = (begin + 1 + counts)[cut.polygon]
    return faces, cut, _read_colors(table, places[:, None] + np.arange(width))


def _read_colors(table: Table, places: NDArray[np.int64]) -> NDArray[Any]:
    """Return the colours at `places` (N, 3 | 4).

    As in Geomview, integer colours range from 0 to 255, and decimal colours from 0 to 1.
    """
    values = table.values[places]
    if table.has_fraction[places].any():
        return stored_colors(values)
    return np.clip(values, 0, 255).astype(np.uint8)


FORMAT = Format(
    "OFF",
    (".off",),
    read,
    write,
    begins=re.compile(rb"\s*+(ST|[CN4n]){0,5}OFF"),
    keeps=("vertex_colors", "face_colors"),
)
