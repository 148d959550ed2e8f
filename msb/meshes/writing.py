"""Helpers of all writers: checks before the first byte is written, and rows of text."""

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.base.origin import Origin, find_origin
from msb.errors import MeshError, OutputError
from msb.meshes.mesh import Mesh

# Number of rows that are formatted and written at a time. Writing in blocks of rows limits the additional
# memory of a writer.
ROWS_AT_A_TIME = 1 << 16


def check_writable(mesh: Mesh) -> None:
    """Reject meshes with non-finite coordinates or invalid indices, because formats cannot store them."""
    _require_finite(mesh.vertices, "is not finite")
    check_indices(mesh)


def check_indices(mesh: Mesh) -> None:
    """Raise MESH_INDEX_OUT_OF_RANGE for the first face with a vertex index out of range."""
    wrong = ((mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))).any(axis=1)
    if wrong.any():
        face = int(np.argmax(wrong))
        row = mesh.faces[face].tolist()
        text = mesh.wrong_face or f"face {face} is {row}, but the mesh has {len(mesh.vertices)} vertices"
        raise MeshError("MESH_INDEX_OUT_OF_RANGE", text, pointer=f"faces[{face}]")


def as_float32(vertices: NDArray[Any], name: str) -> NDArray[np.float32]:
    """Return `vertices` (V, 3) as float32, which is the precision of the format `name`."""
    with np.errstate(over="ignore"):
        narrow = vertices.astype(np.float32, copy=False)
    _require_finite(vertices, "is not finite")
    _require_finite(narrow, f"does not fit into float32, the precision of {name}")
    return narrow


def as_local(vertices: NDArray[Any], name: str) -> tuple[NDArray[np.float32], Origin]:
    """Return `vertices` (V, 3) as float32 relative to an origin. Also return the origin, for the format
    `name`."""
    origin = find_origin(vertices)
    return as_float32(vertices - np.asarray(origin) if any(origin) else vertices, name), origin


def write_rows(stream: BinaryIO, form: str, columns: NDArray[Any]) -> None:
    """Write each row of `columns` (N, K) as a line of text. The format string `form` has a "%" conversion for
    each of the K columns.

    The conversion "%r" writes the shortest decimal that reads back as the same float64. Float32 values are
    therefore also stored exactly.
    """
    line = form + "\n"
    for start in range(0, len(columns), ROWS_AT_A_TIME):
        rows = columns[start : start + ROWS_AT_A_TIME]
        stream.write((line * len(rows) % tuple(rows.ravel().tolist())).encode("ascii"))


def _require_finite(vertices: NDArray[Any], problem: str) -> None:
    """Raise OUTPUT_FORMAT_LIMIT for the first row of `vertices` (V, 3) that is not finite."""
    wrong = ~np.isfinite(vertices).all(axis=1)
    if wrong.any():
        vertex = int(np.argmax(wrong))
        text = f"vertex {vertex} {problem}"
        raise OutputError("OUTPUT_FORMAT_LIMIT", text, pointer=f"vertices[{vertex}]")
