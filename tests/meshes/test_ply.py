"""Read PLY files with their types, lists, skipped elements, polygons and colours. Read PLY tables."""

import struct
from pathlib import Path

import numpy as np
import pytest

from msb.errors import InputError, MeshFileError
from msb.meshes import read_mesh
from msb.meshes.ply_table import read_ply_names, read_ply_table

from .builders import (
    CORNERS,
    OFF_SQUARE,
    SQUARE,
    SQUARE_FACES,
    TEXELS,
    UVS,
    XYZ,
    Read,
    assert_colors,
    picture,
    ply,
    ply_faces,
    ply_floats,
    ply_square,
    ply_text,
)

LITTLE = "binary_little_endian"


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_float_keeps_its_precision_in_both_byte_orders(read: Read, order: str) -> None:
    mesh = read(ply_square(order=order), ".ply")
    assert mesh.vertices.dtype == np.dtype(np.float32)
    assert mesh.vertices.dtype.isnative
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.faces.dtype == np.int64
    assert mesh.faces.tolist() == SQUARE_FACES
    assert mesh.vertex_colors is None
    assert mesh.face_colors is None


def test_double_stays_double(read: Read) -> None:
    rows = np.array([[0.1, 1 / 3, 1e300]])
    lines = ["element vertex 1", *(line.replace("float", "double") for line in XYZ)]
    mesh = read(ply(LITTLE, lines, rows.astype("<f8").tobytes()), ".ply")
    assert mesh.vertices.dtype == np.float64
    assert mesh.vertices.tolist() == rows.tolist()
    assert mesh.faces.shape == (0, 3)


@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b"\r"])
def test_line_ends(read: Read, line_end: bytes) -> None:
    content = ply_text(OFF_SQUARE + b"3 0 1 2\n3 0 2 3\n").replace(b"\n", line_end)
    assert read(content, ".ply").faces.tolist() == SQUARE_FACES


@pytest.mark.parametrize("line_end", [b"\r\n", b"\r"])
def test_binary_body_after_other_line_ends(read: Read, line_end: bytes) -> None:
    lines = ["element vertex 1", *XYZ]
    head = ply(LITTLE, lines, b"").replace(b"\n", line_end)
    # The first byte of the body is a line feed. It must not be read as part of the line end before it.
    body = b"\n" + ply_floats([[1, 2, 3]])[1:]
    mesh = read(head + body, ".ply")
    assert mesh.vertices.tobytes() == body


def test_comments_and_foreign_bytes_in_the_header(read: Read) -> None:
    lines = ["comment na\xefve end_header", "obj_info x", "element vertex 1", *XYZ, "comment"]
    assert read(ply("ascii", lines, b"1 2 3\n"), ".ply").vertices.tolist() == [[1, 2, 3]]


INTEGERS = ["char", "uchar", "short", "ushort", "int", "uint", "int8", "uint8", "int16", "int32", "uint32"]


@pytest.mark.parametrize(("count", "index"), list(zip(INTEGERS, INTEGERS[::-1], strict=True)))
def test_every_integer_type_of_lists(read: Read, count: str, index: str) -> None:
    name = "vertex_index" if len(count) % 2 else "vertex_indices"
    kinds = {"char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h"}
    kinds |= {"ushort": "H", "int": "i", "int32": "i", "uint": "I", "uint32": "I"}
    rows = b"".join(struct.pack(f"<{kinds[count]}3{kinds[index]}", 3, *face) for face in SQUARE_FACES)
    lines = ["element vertex 4", *XYZ, "element face 2", f"property list {count} {index} {name}"]
    assert read(ply(LITTLE, lines, ply_floats(SQUARE) + rows), ".ply").faces.tolist() == SQUARE_FACES


@pytest.mark.parametrize("face", [[0, 1, 9], [0, -1, 2], [2**31 - 1, -(2**31), 0]])
def test_indices_outside_the_mesh_are_kept(read: Read, face: list[int]) -> None:
    assert read(ply_square([face, [0, 1, 2]]), ".ply").faces.tolist() == [face, [0, 1, 2]]


ODD_HEADER = [
    "element cloud 2",
    "property list uchar short data",
    "property uchar flag",
    "element nothing 5",
    "element vertex 4",
    "property uchar before",
    *XYZ,
    "property list uchar uchar tags",
    "property double after",
    "element face 2",
    "property float quality",
    "property list ushort int other",
    "property list uchar int vertex_indices",
    "property uchar red",
    "property uchar green",
    "property uchar blue",
    "element edge 1",
    "property int a",
]


def odd_binary() -> bytes:
    body = struct.pack("<BhB BhhB", 1, 7, 0, 2, 8, 9, 0)
    for number, row in enumerate(SQUARE):
        body += struct.pack("<B3fB", 9, *row, number) + bytes(number) + struct.pack("<d", 0.5)
    for face, color in zip(SQUARE_FACES, [[1, 2, 3], [4, 5, 6]], strict=True):
        body += struct.pack("<fHiiB3i3B", 0.5, 2, 40, 50, 3, *face, *color)
    return ply(LITTLE, ODD_HEADER, body + struct.pack("<i", 1))


def odd_text() -> bytes:
    rows = ["1 7 0", "2 8 9 0", "9 0 0 0 0 .5", "9 1 0 0 1 7 .5", "9 1 1 0 2 7 7 .5", "9 0 1 0 0 .5"]
    rows += ["0.5 2 40 50 3 0 1 2 1 2 3", "", "0.5 0 3 0 2 3 4 5 6", "1"]
    return ply("ascii", ODD_HEADER, "\n".join(rows).encode("ascii"))


@pytest.mark.parametrize(("content", "dtype"), [(odd_binary(), np.float32), (odd_text(), np.float64)])
def test_other_elements_and_properties_are_skipped(read: Read, content: bytes, dtype: type) -> None:
    mesh = read(content, ".ply")
    assert mesh.vertices.dtype == dtype
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.faces.tolist() == SQUARE_FACES
    assert_colors(mesh.face_colors, np.uint8([[1, 2, 3], [4, 5, 6]]))


@pytest.mark.parametrize(
    ("kind", "stored", "expected"),
    [
        ("uchar", [255, 0, 7], np.uint8([255, 0, 7])),
        ("float", [1.0, 0.0, 0.25], np.float32([1, 0, 0.25])),
        ("double", [1.0, 0.0, 0.25], np.float32([1, 0, 0.25])),
        ("float", [255.0, 0.0, 7.0], np.uint8([255, 0, 7])),
        ("float", [1.5, -1.0, np.nan], np.float32([1, 0, 0])),
        ("ushort", [65535, 0, 13107], np.float32([1, 0, 0.2])),
        ("int", [300, -5, 7], np.uint8([255, 0, 7])),
    ],
)
@pytest.mark.parametrize("prefix", ["", "diffuse_"])
def test_colors(read: Read, kind: str, stored: list[float], expected: np.ndarray, prefix: str) -> None:
    names = [f"property {kind} {prefix}{name}" for name in ("red", "green", "blue")]
    dtype = {"uchar": "u1", "float": "<f4", "double": "<f8", "ushort": "<u2", "int": "<i4"}[kind]
    lines = ["element vertex 1", *XYZ, *names]
    binary = ply(LITTLE, lines, ply_floats([[0, 0, 0]]) + np.array(stored, dtype=dtype).tobytes())
    text = ply("ascii", lines, f"0 0 0 {' '.join(map(str, stored))}\n".encode("ascii"))
    for content in (binary, text):
        assert_colors(read(content, ".ply").vertex_colors, expected[None])


def test_face_colors_follow_their_triangles(read: Read) -> None:
    names = [f"property uchar {name}" for name in ("red", "green", "blue", "alpha")]
    lines = ["element vertex 4", *XYZ, "element face 3", CORNERS, *names]
    rows = [(4, 0, 1, 2, 3, 9, 8, 7, 6), (2, 0, 1, 1, 1, 1, 1), (3, 0, 1, 2, 5, 4, 3, 2)]
    body = b"".join(struct.pack(f"<B{row[0]}i4B", *row) for row in rows)
    mesh = read(ply(LITTLE, lines, ply_floats(SQUARE) + body), ".ply")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert_colors(mesh.face_colors, np.uint8([[9, 8, 7, 6], [9, 8, 7, 6], [5, 4, 3, 2]]))


def test_meshes_without_faces_or_vertices_are_valid(read: Read) -> None:
    assert read(ply("ascii", ["element vertex 0", *XYZ], b""), ".ply").vertices.shape == (0, 3)
    lines = ["element vertex 0", *XYZ, "element face 0", CORNERS]
    mesh = read(ply(LITTLE, lines, b""), ".ply")
    assert mesh.vertices.shape == mesh.faces.shape == (0, 3)
    assert mesh.vertices.dtype == np.float32


HEAD = "ply\nformat {} 1.0\nelement vertex 3\n"
HEAD += "property float a\nproperty double b\nproperty uchar c\nend_header\n"
ROWS = [(1.5, 2.5, 3), (-1.0, 1e300, 4), (0.25, 7.0, 255)]


def binary(order: str) -> bytes:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    row = np.dtype([("a", order + "f4"), ("b", order + "f8"), ("c", "u1")])
    return HEAD.format(name).encode() + np.array(ROWS, row).tobytes()


TEXT = HEAD.format("ascii").encode() + b"".join(b"%r %r %d\n" % row for row in ROWS)


@pytest.mark.parametrize("data", [binary("<"), binary(">"), TEXT], ids=["little", "big", "text"])
def test_columns_of_every_encoding(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "t.ply").write_bytes(data)
    assert read_ply_names(tmp_path / "t.ply") == (("a", "b", "c"), False)
    table = read_ply_table(tmp_path / "t.ply")
    assert (table.count, table.names) == (3, ("a", "b", "c"))
    columns = table.columns(["c", "a"])
    assert columns.dtype == np.float32
    np.testing.assert_array_equal(columns, [[3, 1.5], [4, -1.0], [255, 0.25]])
    np.testing.assert_array_equal(table.columns(["b"]), [[2.5], [np.inf], [7.0]])


BAD = {
    "short": (binary("<")[:-1], "TRUNCATED"),
    "long": (binary("<") + b"x", "INVALID"),
    "text short": (TEXT[:-8], "INVALID"),
    "list": (TEXT.replace(b"uchar c", b"list uchar int c"), "INVALID"),
    "other element": (TEXT.replace(b"element vertex", b"element point"), "INVALID"),
    "huge": (binary("<").replace(b"x 3", b"x 999999999999999999"), "TRUNCATED"),
    "empty": (b"", "INVALID"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_tables(case: str, tmp_path: Path) -> None:
    data, code = BAD[case]
    (tmp_path / "t.ply").write_bytes(data)
    with pytest.raises(MeshFileError, match=f"MESH_FILE_{code}: {tmp_path / 't.ply'}: "):
        read_ply_table(tmp_path / "t.ply")
    with pytest.raises(InputError):
        read_ply_table(tmp_path / "none.ply")


def test_mixed_coordinate_types_become_float64(read: Read) -> None:
    lines = ["element vertex 1", "property short x", "property double y", "property float z"]
    mesh = read(ply(LITTLE, lines, struct.pack("<hdf", -3, 0.1, 0.5)), ".ply")
    assert mesh.vertices.dtype == np.float64
    assert mesh.vertices.tolist() == [[-3, 0.1, 0.5]]


def test_faces_may_come_before_vertices(read: Read) -> None:
    lines = ["element face 2", CORNERS, "element vertex 4", *XYZ]
    content = ply(LITTLE, lines, ply_faces(SQUARE_FACES) + ply_floats(SQUARE))
    assert read(content, ".ply").faces.tolist() == SQUARE_FACES


PLY_UVS = [[0, 0], [1, 0], [1, 1], [0, 1]]


def textured_ply(order: str, by_vertex: bool, lists: list[list[float]] | None = None, **names: str) -> bytes:
    """Return the square with texture coordinates of vertices or faces. Without an `order` it is text."""
    images = names.get("images", "TextureFile a.png").split(";")
    form = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = [*(f"comment {image}" for image in images), "element vertex 4", *XYZ]
    lines += ["property float s", "property float t"] if by_vertex else []
    lines += ["element face 2", CORNERS, "property int texnumber"]
    lines += [] if by_vertex else ["property list uchar float texcoord"]
    rows = [[*p, *uv] if by_vertex else p for p, uv in zip(SQUARE, PLY_UVS, strict=True)]
    if lists is None:
        lists = [[value for corner in face for value in PLY_UVS[corner]] for face in SQUARE_FACES]
    number = int(names.get("number", "0"))
    if not order:
        text = [" ".join(map(str, row)) for row in rows]
        for face, values, texture in zip(SQUARE_FACES, lists, (0, number), strict=True):
            tail = [] if by_vertex else [len(values), *values]
            text.append(" ".join(map(str, [3, *face, texture, *tail])))
        return ply(form, lines, ("\n".join(text) + "\n").encode())
    body = ply_floats(rows, order)
    for face, values, texture in zip(SQUARE_FACES, lists, (0, number), strict=True):
        body += ply_faces([face], order) + np.array([texture], f"{order}i4").tobytes()
        body += b"" if by_vertex else bytes([len(values)]) + np.array(values, f"{order}f4").tobytes()
    return ply(form, lines, body)


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("by_vertex", [True, False])
def test_a_texture_in_a_comment_is_read(read: Read, tmp_path: Path, order: str, by_vertex: bool) -> None:
    (tmp_path / "a.png").write_bytes(picture())
    mesh = read(textured_ply(order, by_vertex), ".ply")
    assert [image.tolist() for image in mesh.textures] == [TEXELS.tolist()]
    uvs = mesh.vertex_uvs[mesh.faces].reshape(-1, 2) if by_vertex else mesh.corner_uvs
    assert uvs.tolist() == [UVS[corner] for face in SQUARE_FACES for corner in face]
    assert mesh.left_out == ()
    bare = read_mesh(tmp_path / "mesh.ply", images=False)
    assert (bare.textures, (bare.vertex_uvs if by_vertex else bare.corner_uvs) is None) == ((), False)


def test_several_textures_are_numbered_by_the_faces(read: Read, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(picture())
    (tmp_path / "b c.png").write_bytes(picture(TEXELS[::-1]))
    images = "TextureFile a.png;TextureFile b c.png"
    mesh = read(textured_ply("<", False, images=images, number="1"), ".ply")
    assert [image.tolist() for image in mesh.textures] == [TEXELS.tolist(), TEXELS[::-1].tolist()]
    assert mesh.face_textures.tolist() == [0, 1]
    mesh = read(textured_ply("<", False, images=images, number="7"), ".ply")
    assert [image.shape for image in mesh.textures] == [(2, 2, 3), (1, 1, 3)]


def test_faces_without_texture_coordinates_are_white(read: Read, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(picture())
    mesh = read(textured_ply("<", False, [[0, 0, 1, 0, 1, 1], []]), ".ply")
    assert [image.shape for image in mesh.textures] == [(2, 2, 3), (1, 1, 3)]
    assert mesh.face_textures.tolist() == [0, 1]


@pytest.mark.parametrize(
    "content",
    [
        textured_ply("<", False),
        textured_ply("", False, images="TextureFile ../a.png"),
        textured_ply("", False, [[0, 0, 1, 0], [0] * 6]),
        ply_square().replace(b"element vertex", b"comment TextureFile a.png\nelement vertex"),
    ],
    ids=["absent", "other folder", "too few coordinates", "no coordinates"],
)
def test_textures_that_cannot_be_read_are_named(read: Read, content: bytes) -> None:
    mesh = read(content, ".ply")
    assert (mesh.vertices.tolist(), mesh.faces.tolist(), mesh.textures) == (SQUARE, SQUARE_FACES, ())
    assert ["a.png" in text for text in mesh.left_out] == [True]
