"""Wavefront OBJ: polygon meshes as text."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from msb.meshes.colors import stored_colors
from msb.meshes.formats import Format
from msb.meshes.mesh import Mesh
from msb.meshes.obj_materials import names_materials, with_coordinates, with_materials
from msb.meshes.obj_write import beside, write
from msb.meshes.polygons import fan_triangulate, wrong_polygon
from msb.meshes.source import Source
from msb.meshes.text import Words, first_not_whole, word_blocks

_COLOR_WIDTHS = {6: 3, 7: 4}
"""Number of values on a `v` line -> how many of the last ones are a colour."""

_LEFT_OUT = {b"vn": "normals", b"vt": "UVs", b"usemtl": "materials and their textures", b"l": "lines"}
"""Words of lines that are not read -> what these hold."""

_UNSUPPORTED = (b"surf", b"call", b"csh")
"""Words of lines that are refused: free-form surfaces, which are no polygons; other files and shell commands,
which we never open or run."""


@dataclass
class _Parts:
    """The parts that were read from the blocks of a file so far."""

    vertex_count: int = 0
    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    colors: list[NDArray[np.float64]] = field(default_factory=list)
    color_widths: set[int] = field(default_factory=set)
    corners: list[NDArray[np.int64]] = field(default_factory=list)
    counts: list[NDArray[np.int64]] = field(default_factory=list)
    left_out: set[bytes] = field(default_factory=set)


def read(source: Source) -> Mesh:
    """Read `v` and `f` lines, and where materials have images or colours `vt` and `usemtl`, too.

    Vertices are float64. Colours come from `v x y z r g b [a]`, if every `v` line has them.
    """
    text = source.as_text("OBJ")
    if b"\\" in text.data:
        joined = text.data.replace(b"\\\r\n", b"   ").replace(b"\\\n", b"  ")
        text = replace(text, data=joined, lines=text.data)
    parts = _Parts()
    for words in word_blocks(text, comments=True):
        _refuse_unsupported(words)
        is_vertex = words.lines_beginning(b"v")
        _add_faces(parts, words, is_vertex)
        _add_vertices(parts, words, is_vertex)
        parts.left_out |= {
            word for word in _LEFT_OUT.keys() - parts.left_out if words.lines_beginning(word).any()
        }
    if not parts.vertex_count:
        raise source.not_a("OBJ", "it has no 'v x y z' line")
    faces, polygon = fan_triangulate(np.concatenate(parts.corners), np.concatenate(parts.counts))
    wrong = wrong_polygon(faces, polygon, parts.vertex_count)
    wrong_face = None if wrong is None else _wrong_face(text, *wrong, parts.vertex_count)
    colors = None
    if parts.color_widths in ({3}, {4}):
        colors = stored_colors(np.concatenate(parts.colors))
    mesh = Mesh(np.concatenate(parts.vertices), faces, colors, wrong_face=wrong_face)
    more: dict[str, None] = {}
    if names_materials(text):
        if source.images:
            mesh, more = with_materials(mesh, text)
        elif b"vt" in parts.left_out:
            mesh = with_coordinates(mesh, text)
        parts.left_out -= {b"usemtl", b"vt"} if mesh.textures or not source.images else {b"usemtl"}
    left_out = [what for word, what in _LEFT_OUT.items() if word in parts.left_out]
    return replace(mesh, left_out=(*left_out, *more))


def _refuse_unsupported(words: Words) -> None:
    for keyword in _UNSUPPORTED:
        lines = np.flatnonzero(words.lines_beginning(keyword))
        if lines.size:
            name = keyword.decode()
            text = f"'{name}' is not read; only polygons ('f' lines) in this one file are"
            raise words.line_error("MESH_FILE_UNSUPPORTED", int(lines[0]), text)


def _add_vertices(parts: _Parts, words: Words, is_vertex: NDArray[np.bool_]) -> None:
    """Append the vertices of the `is_vertex` (L,) lines."""
    widths = words.count[is_vertex] - 1
    wrong = np.flatnonzero((widths < 3) | (widths > 7) | (widths == 5))
    if wrong.size:
        line = int(np.flatnonzero(is_vertex)[wrong[0]])
        text = f"'v' has {widths[wrong[0]]} numbers; x y z, x y z w, x y z r g b or x y z r g b a is right"
        raise words.line_error("MESH_FILE_INVALID", line, text)
    values = words.numbers(words.arguments(is_vertex))
    first = np.cumsum(widths) - widths
    parts.vertices.append(values[first[:, None] + np.arange(3)])
    parts.vertex_count += len(widths)
    widths_here = {_COLOR_WIDTHS.get(width, 0) for width in np.unique(widths).tolist()}
    parts.color_widths |= widths_here
    if widths_here in ({3}, {4}):
        parts.colors.append(values.reshape(len(widths), -1)[:, 3:])


def _add_faces(parts: _Parts, words: Words, is_vertex: NDArray[np.bool_]) -> None:
    """Append the polygons of the `f` and `fo` lines; `is_vertex` (L,) says where vertices come between."""
    is_face = _face_lines(words)
    counts = words.count[is_face] - 1
    values = words.without_suffix(b"/").numbers(words.arguments(is_face))
    bad = first_not_whole(values)
    if bad is not None:
        text = f"index {values[bad]!s} is not a whole number of at most 2**53"
        raise words.line_error("MESH_FILE_INVALID", _line_of(is_face, counts, bad), text)
    index = values.astype(np.int64)
    corners = index - 1
    if (index < 0).any():
        above = (parts.vertex_count + np.cumsum(is_vertex))[is_face]
        corners = np.where(index < 0, np.repeat(above, counts) + index, corners)
    wrong = np.flatnonzero((index == 0) | (corners < 0))
    if wrong.size:
        value = int(index[wrong[0]])
        text = f"index {value} is not allowed: indices begin with 1, or with -1 for the vertex just above"
        line = _line_of(is_face, counts, int(wrong[0]))
        raise words.line_error("MESH_FILE_INVALID", line, text)
    parts.corners.append(corners)
    parts.counts.append(counts)


def _face_lines(words: Words) -> NDArray[np.bool_]:
    return words.lines_beginning(b"f") | words.lines_beginning(b"fo")


def _wrong_face(text: Source, polygon: int, index: int, vertices: int) -> str:
    """Return where the polygon stands that names no vertex; the file is gone through again for it."""
    for words in word_blocks(text, comments=True):
        lines = np.flatnonzero(_face_lines(words))
        if polygon < len(lines):
            byte = words.base + int(words.start[words.first[lines[polygon]]])
            return text.wrong_index(byte, index, vertices, first=1)
        polygon -= len(lines)
    raise AssertionError


def _line_of(is_face: NDArray[np.bool_], counts: NDArray[np.int64], corner: int) -> int:
    """Return the line of corner number `corner`; the face lines (L,) hold `counts` corners each."""
    face = np.searchsorted(np.cumsum(counts), corner, side="right")
    return int(np.flatnonzero(is_face)[face])


FORMAT = Format("OBJ", (".obj",), read, write, beside=beside, keeps=("vertex_colors", "textures"))
