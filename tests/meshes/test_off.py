"""Read OFF files: all prefixes, vertex colours and face colours."""

import numpy as np
import pytest

from msb.meshes import text

from .builders import OFF_SQUARE, SQUARE, SQUARE_FACES, Read, assert_colors, off

FACES = b"3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize("block", [1, text.BLOCK_BYTES])
@pytest.mark.parametrize(
    "head",
    [
        b"OFF\n4 2 0",
        b"OFF\n4 2",
        b"OFF 4 2 0",
        b"OFF4 2 0",
        b"\n# made by hand\n OFF # keyword\n\n# counts\n  4\t2 5 # V F E",
        b"\xef\xbb\xbfOFF\r\n4 2 0\r",
        b"COFF\n4 2 0",
    ],
)
def test_spellings_of_the_header(
    read: Read, monkeypatch: pytest.MonkeyPatch, head: bytes, block: int
) -> None:
    monkeypatch.setattr(text, "BLOCK_BYTES", block)
    vertices = OFF_SQUARE.replace(b"1 1 0", b"1 1 0 # corner 3 of 4\n\n#")
    mesh = read(off(head, vertices, FACES), ".off")
    assert mesh.vertices.dtype == np.float64
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.faces.tolist() == SQUARE_FACES
    assert mesh.vertex_colors is None
    assert mesh.face_colors is None


@pytest.mark.parametrize(
    ("prefix", "before", "after"),
    [
        ("C", "", ""),
        ("NC", "0 0 1 ", ""),
        ("CN", "0 0 1 ", ""),
        ("STC", "", " .5 .5"),
        ("STCN", "0 0 1 ", " 0 1"),
    ],
)
@pytest.mark.parametrize(
    ("color", "expected"),
    [
        ("255 0 7", np.uint8([255, 0, 7])),
        ("255 0 7 128", np.uint8([255, 0, 7, 128])),
        ("1 0 0", np.uint8([1, 0, 0])),
        ("1.0 0 0.25", np.float32([1, 0, 0.25])),
        ("1.0 0 0 0.5", np.float32([1, 0, 0, 0.5])),
        ("300 -5 7", np.uint8([255, 0, 7])),
    ],
)
def test_vertex_colors(
    read: Read, prefix: str, before: str, after: str, color: str, expected: np.ndarray
) -> None:
    rows = "".join(f"{line} {before}{color}{after}\n" for line in OFF_SQUARE.decode("ascii").splitlines())
    mesh = read(off(f"{prefix}OFF\n4 2 0".encode("ascii"), rows.encode("ascii"), FACES), ".off")
    assert mesh.vertices.tolist() == SQUARE
    assert_colors(mesh.vertex_colors, np.stack([expected] * 4))


@pytest.mark.parametrize(("prefix", "extra"), [(b"N", b" 0 0 1"), (b"ST", b" 0 1"), (b"STN", b" 0 0 1 0 1")])
def test_normals_and_textures_are_ignored(read: Read, prefix: bytes, extra: bytes) -> None:
    content = off(prefix + b"OFF\n4 2 0", OFF_SQUARE.replace(b"\n", extra + b"\n"), FACES)
    mesh = read(content, ".off")
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.vertex_colors is None


def test_a_single_decimal_makes_all_colors_decimals(read: Read) -> None:
    rows = b"0 0 0 1 0 0\n1 0 0 0 0.5 0\n1 1 0 0 0 1\n0 1 0 1 1 1\n"
    colors = read(off(b"COFF\n4 2 0", rows, FACES), ".off").vertex_colors
    assert_colors(colors, np.float32([[1, 0, 0], [0, 0.5, 0], [0, 0, 1], [1, 1, 1]]))


@pytest.mark.parametrize(
    ("faces", "expected"),
    [
        (b"3 0 1 2 1 2 3\n3 0 2 3 4 5 6\n", np.uint8([[1, 2, 3], [4, 5, 6]])),
        (b"3 0 1 2 1 2 3 255\n2 0 1\n3 0 2 3 4 5 6 7\n", np.uint8([[1, 2, 3, 255], [4, 5, 6, 7]])),
        (b"3 0 1 2 0.5 0 0\n3 0 2 3 0 1 0\n", np.float32([[0.5, 0, 0], [0, 1, 0]])),
        (b"4 0 1 2 3 9 8 7\n", np.uint8([[9, 8, 7], [9, 8, 7]])),
        (b"3 0 1 2 1 2 3\n3 0 2 3\n", None),
        (b"3 0 1 2 1 2 3\n3 0 2 3 4 5 6 7\n", None),
        (b"3 0 1 2 17\n3 0 2 3 17\n", None),
    ],
)
def test_face_colors(read: Read, faces: bytes, expected: np.ndarray | None) -> None:
    count = faces.count(b"\n")
    mesh = read(off(f"OFF\n4 {count} 0".encode("ascii"), OFF_SQUARE, faces), ".off")
    assert mesh.faces.tolist() == SQUARE_FACES
    assert_colors(mesh.face_colors, expected)


def test_an_empty_mesh_is_valid(read: Read) -> None:
    assert read(b"OFF 0 0 0", ".off").faces.shape == (0, 3)
