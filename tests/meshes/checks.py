"""Checks for the test of any mesh format: reading, round trips, and invalid files.

    def test_tri(tmp_path: Path) -> None:
        check_format(FORMAT, b"tri\\n0 0 0 1 0 0 1 1 0\\n", [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]], tmp_path)
        check_bad(FORMAT, b"tri\\n0 0\\n", "MESH_FILE_INVALID", tmp_path)

is a complete test.
"""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.errors import MeshError, MeshFileError, OutputError
from msb.meshes import Mesh, read_mesh, write_mesh
from msb.meshes.formats import Format

BYTES = np.random.default_rng(1).integers(0, 2, (9, 4), dtype=np.uint8)
"""Bytes that are only zeros and ones. In text files, a reader may mistake them for decimals in [0, 1]."""
FLOATS = np.random.default_rng(2).random((9, 4), dtype=np.float32)
COLORS = {
    "none": None,
    "uint8 rgb": BYTES[:, :3].copy(),
    "uint8 rgba": BYTES,
    "float32 rgb": FLOATS[:, :3].copy(),
    "float32 rgba": FLOATS,
}


def make(dtype: type, colors: str = "none", face_colors: str = "none") -> Mesh:
    """Return a mesh with an unused vertex, two equal vertices, and faces in irregular order."""
    vertices = np.random.default_rng(0).normal(size=(9, 3)).astype(dtype)
    vertices[3] = vertices[1]
    vertices[4] = [0, 1e-30, -1e30]
    faces = np.array([[7, 1, 0], [3, 2, 1], [5, 5, 6], [0, 1, 7], [7, 1, 0]])
    rows = COLORS[face_colors]
    return Mesh(vertices, faces, COLORS[colors], None if rows is None else rows[: len(faces)])


def written(mesh: Mesh, suffix: str) -> bytes:
    """Return the content of the file that is written for a mesh."""
    stream = io.BytesIO()
    write_mesh(mesh, stream, suffix=suffix)
    return stream.getvalue()


def equal(array: NDArray[Any] | None, other: NDArray[Any] | None) -> bool:
    """Return whether both are None, or equal arrays of the same type."""
    if array is None or other is None:
        return array is other
    return array.dtype == other.dtype and np.array_equal(array, other)


def round_trip(mesh: Mesh, suffix: str, folder: Path) -> Mesh:
    """Write and read `mesh`. Check that writing is deterministic and does not change the arrays."""
    arrays = [array for array in vars(mesh).values() if isinstance(array, np.ndarray)]
    before = [array.copy() for array in arrays]
    path = folder / f"mesh{suffix}"
    write_mesh(mesh, path, suffix=suffix.upper())
    assert path.read_bytes() == written(mesh, suffix)
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)
    return read_mesh(path)


def check_format(form: Format, example: bytes, triangles: Sequence[Any], folder: Path) -> None:
    """Check a format against its declaration. `triangles` (F, 3, 3) are the triangles in `example`."""
    for suffix in form.suffixes:
        for path in (folder / f"a{suffix}", folder / f"b{suffix.upper()}"):
            path.write_bytes(example)
            mesh = read_mesh(path)
            np.testing.assert_array_equal(mesh.vertices[mesh.faces], np.array(triangles))
    check_bad(form, b"", "MESH_FILE_INVALID", folder)
    if form.write is None:
        return
    for dtype in (np.float32, np.float64):
        for colors in COLORS:
            _check_round_trip(form, make(dtype, colors, colors), folder)
    check_refusals(form)


def _check_round_trip(form: Format, mesh: Mesh, folder: Path) -> None:
    again = round_trip(mesh, form.suffixes[0], folder)
    stored = mesh.vertices.astype(np.float32) if form.is_single else mesh.vertices
    corners = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    assert np.array_equal(again.faces, corners if form.is_soup else mesh.faces)
    assert np.array_equal(again.vertices, stored[mesh.faces].reshape(-1, 3) if form.is_soup else stored)
    for name in ("vertex_colors", "face_colors"):
        before, after = getattr(mesh, name), getattr(again, name)
        assert (after is None) == (before is None or name not in form.keeps), name
        if after is not None:
            np.testing.assert_allclose(
                _decimal(after), _decimal(before), atol=1e-4 if form.is_linear else 1e-6
            )


def _decimal(colors: NDArray[Any]) -> NDArray[np.float64]:
    """Return colours (N, 4) in [0, 1]."""
    values = colors / (255 if colors.dtype == np.uint8 else 1)
    return np.concatenate([values, np.ones((len(values), 4 - values.shape[1]))], axis=1)


def check_refusals(form: Format) -> None:
    """Check that invalid coordinates and indices are rejected before the first byte is written."""
    for row, value in ((4, np.nan), (2, -np.inf), (1, 1e39)):
        mesh = make(np.float64)
        mesh.vertices[row, 1] = value
        if np.isfinite(value) and not form.is_single:
            continue
        _check_refused(form, mesh, OutputError, f"OUTPUT_FORMAT_LIMIT: vertex {row} ")
    for index in (-1, 9):
        mesh = make(np.float32)
        mesh.faces[1, 2] = index
        _check_refused(form, mesh, MeshError, f"MESH_INDEX_OUT_OF_RANGE: face 1 is [3, 2, {index}]")


def _check_refused(form: Format, mesh: Mesh, kind: type[Exception], begins: str) -> None:
    stream = io.BytesIO()
    with pytest.raises(kind) as caught:
        write_mesh(mesh, stream, suffix=form.suffixes[0])
    assert str(caught.value).startswith(begins)
    assert stream.getvalue() == b""


def check_bad(form: Format, content: bytes, code: str, folder: Path) -> None:
    """Check that an invalid file gives an error of one line, with the code and the name of the file."""
    path = folder / f"bad{form.suffixes[0]}"
    path.write_bytes(content)
    with pytest.raises(MeshFileError) as caught:
        read_mesh(path)
    error = caught.value
    assert (error.code, error.file) == (code, str(path))
    assert str(error) == f"{code}: {path}: {error.message}"
    assert str(error).isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None
