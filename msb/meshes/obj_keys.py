"""Computes the seam keys of OBJ files.

Seam keys are computed from normals and texture coordinates, and explain duplicated positions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msb.base.seam_keys import hash_attributes
from msb.errors import MeshFileError
from msb.meshes.mesh import Mesh
from msb.meshes.obj_materials import select_face_lines
from msb.meshes.polygons import Triangulation
from msb.meshes.source import Source
from msb.meshes.text import Words, word_blocks


def read_corner_keys(mesh: Mesh, text: Source, cut: Triangulation) -> NDArray[np.uint32] | None:
    """Return the seam keys (3F,) of the corners of `mesh`, or None. The mesh was read from `text`.

    The argument `cut` is the triangulation of the polygons. The keys matter only if two vertices coincide.
    The result is None if normals or texture coordinates are malformed.
    """
    with np.errstate(over="ignore"):
        places = np.ascontiguousarray(mesh.vertices.astype(np.float32) + np.float32(0))
    if len(np.unique(places.view(np.dtype((np.void, 12))))) == len(places):
        return None
    try:
        keys = _read_keys(text)
    except MeshFileError:
        return None
    return None if keys is None else np.asarray(keys[cut.order.reshape(-1)])


def _read_keys(text: Source) -> NDArray[np.uint32] | None:
    """Return the hash (C,) of the normal and texture coordinates of each polygon corner."""
    # Read the lines of normals and of texture coordinates, padded to three numbers. The line index is -1 for
    # a corner without a line.
    values: dict[bytes, list[NDArray[np.float64]]] = {b"vt": [], b"vn": []}
    rows: dict[bytes, list[NDArray[np.int64]]] = {b"vt": [], b"vn": []}
    above = {b"vt": 0, b"vn": 0}
    for words in word_blocks(text, comments=True):
        is_face = select_face_lines(words)
        chosen = words.arguments(is_face)
        second = words.after(b"/")
        for word, part in ((b"vt", second.without_suffix(b"/")), (b"vn", second.after(b"/"))):
            is_line = words.lines_beginning(word)
            values[word].append(_read_lines(words, is_line))
            named = chosen & (part.end > part.start)
            row = np.full(len(words.start), -1, np.int64)
            row[named] = part.indices(named, above[word] + np.cumsum(is_line), "element")
            rows[word].append(row[chosen])
            above[word] += int(is_line.sum())
    # Compute `columns`, the values (C, 3) at each polygon corner. Corners without a line (-1) get the last
    # row.
    columns = []
    for word, stored in values.items():
        table = np.concatenate([*stored, np.full((1, 3), np.inf)])
        row = np.concatenate(rows[word])
        # Lines may be missing, as in files without any vt.
        if not row.size or row.max() < above[word]:
            columns.append(table[row])
    return hash_attributes(columns) if columns else None


def _read_lines(words: Words, is_line: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the first three numbers (N, 3) of the selected lines. Missing numbers are 0."""
    widths = words.count[is_line] - 1
    numbers = words.numbers(words.arguments(is_line))
    first, result = np.cumsum(widths) - widths, np.zeros((len(widths), 3))
    for column in range(3):
        has = widths > column
        result[has, column] = numbers[first[has] + column]
    return result
