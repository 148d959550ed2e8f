"""Read STL files: three float32 vertices per face, binary and text."""

import numpy as np
import pytest

from msb.meshes import text

from .builders import SQUARE, Read, stl_binary, stl_facet, stl_text

TRIANGLES = [SQUARE[:3], [SQUARE[1]] * 3, SQUARE[:3]]
"""A face, a degenerate face, and the first face again. None may be merged or dropped."""


def facets() -> list[bytes]:
    """Return `TRIANGLES` as text."""
    return [stl_facet([" ".join(map(str, row)) for row in triangle]) for triangle in TRIANGLES]


@pytest.mark.slow
@pytest.mark.parametrize("block", [1, text.BLOCK_BYTES])
@pytest.mark.parametrize(
    "content",
    [
        stl_binary(TRIANGLES),
        stl_binary(TRIANGLES, header=b"solid but binary"),
        stl_binary(TRIANGLES, header=b"OFF ply glTF"),
        stl_text(*facets()),
        stl_text(*facets()).upper().replace(b"\n", b"\r\n"),
        stl_text(*facets()).replace(b"\n", b"\r"),
        stl_text(*facets()).replace(b"\n", b"\n\n \t"),
        stl_text(facets()[0]) + stl_text(name=b"empty") + stl_text(*facets()[1:], name=b"rest"),
        stl_text(*facets(), name=b"vertex 1 2 3 endsolid facet"),
        stl_text(*facets(), name=b"na\xefve"),
        b"  \n" + stl_text(*facets(), name=b""),
    ],
)
def test_three_rows_per_face(read: Read, monkeypatch: pytest.MonkeyPatch, content: bytes, block: int) -> None:
    monkeypatch.setattr(text, "BLOCK_BYTES", block)
    mesh = read(content, ".stl")
    assert mesh.vertices.dtype == np.float32
    assert mesh.vertices.dtype.isnative
    assert mesh.vertices.reshape(-1, 3, 3).tolist() == TRIANGLES
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert mesh.faces.dtype == np.int64
    assert mesh.vertex_colors is None


def test_text_becomes_the_nearest_float32(read: Read) -> None:
    mesh = read(stl_text(stl_facet(["0.1 1e-50 1e39", "nan inf -inf", "1.00000001 0 0"])), ".stl")
    expected = [[np.float32(0.1), 0, np.inf], [np.nan, np.inf, -np.inf], [1, 0, 0]]
    np.testing.assert_array_equal(mesh.vertices, np.float32(expected))


@pytest.mark.parametrize("content", [stl_binary([]), stl_text(), b"solid\nendsolid"])
def test_files_without_faces_are_valid(read: Read, content: bytes) -> None:
    mesh = read(content, ".stl")
    assert mesh.vertices.shape == mesh.faces.shape == (0, 3)
