"""Write and read mesh files, also with other libraries; report invalid indices and suffixes."""

import io
import re
import struct
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.errors import InputError, MeshError, MeshFileError, OutputError
from msb.meshes import Mesh, read_mesh, write_mesh, writing
from msb.meshes.formats import Style

from .builders import SMALL, SQUARE, SQUARE_FACES, SUFFIXES
from .checks import BYTES, equal, make, round_trip, written
from .test_glb_write import opened


def test_stl_normals_are_unit_length_and_zero_for_no_area() -> None:
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0.0]])
    content = written(Mesh(vertices, np.array([[0, 1, 2], [2, 1, 0], [0, 1, 1]])), ".stl")
    normals = [struct.unpack_from("<3f", content, 84 + 50 * face) for face in range(3)]
    assert normals == [(0, 0, 1), (0, 0, -1), (0, 0, 0)]
    assert not content.lower().startswith(b"solid")


def test_writing_in_blocks_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = make(np.float64, "uint8 rgba")
    whole = [written(mesh, suffix) for suffix in (".ply", ".obj", ".off")]
    monkeypatch.setattr(writing, "ROWS_AT_A_TIME", 2)
    monkeypatch.setattr("msb.meshes.ply.ROWS_AT_A_TIME", 2)
    assert [written(mesh, suffix) for suffix in (".ply", ".obj", ".off")] == whole


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_a_mesh_without_faces(suffix: str, tmp_path: Path) -> None:
    mesh = Mesh(make(np.float64).vertices, np.zeros((0, 3), dtype=np.int64), BYTES)
    again = round_trip(mesh, suffix, tmp_path)
    assert equal(again.vertices, mesh.vertices)
    assert equal(again.faces, mesh.faces)


def test_glb_rejects_a_mesh_without_faces() -> None:
    mesh = Mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(OutputError, match="OUTPUT_FORMAT_LIMIT"):
        written(mesh, ".glb")
    assert len(written(mesh, ".stl")) == 84


def test_glb_is_unlit_and_two_sided_and_has_bounds() -> None:
    mesh = make(np.float32, "uint8 rgb")
    content = written(mesh, ".glb")
    root = opened(content)[0]
    assert root["extensionsUsed"] == ["KHR_materials_unlit"]
    assert root["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    assert root["materials"][0]["doubleSided"] is True
    assert len(root["meshes"]) == len(root["meshes"][0]["primitives"]) == 1
    position, color, indices = root["accessors"]
    assert position["min"] == mesh.vertices.min(axis=0).tolist()
    assert position["max"] == mesh.vertices.max(axis=0).tolist()
    assert (indices["componentType"], indices["count"]) == (5123, 15)
    assert (color["componentType"], color["type"], color["normalized"]) == (5123, "VEC4", True)
    assert all(view["byteOffset"] % 4 == 0 for view in root["bufferViews"])
    assert len(content) % 4 == 0


@pytest.mark.oracle
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb", ".stl"])
def test_trimesh_reads_our_files(suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh", minversion="5")
    mesh = make(np.float32, "uint8 rgba")
    stream = io.BytesIO()
    write_mesh(mesh, stream, suffix=suffix, style=Style("srgb"))
    stream.seek(0)
    # If trimesh reads materials, it does not return vertex colours.
    options = {"skip_materials": True} if suffix == ".glb" else {"maintain_order": True}
    loaded = trimesh.load_mesh(stream, file_type=suffix[1:], process=False, **options)
    expected = mesh.vertices[mesh.faces].reshape(-1, 3) if suffix == ".stl" else mesh.vertices
    np.testing.assert_array_equal(np.float32(loaded.vertices), expected)
    if suffix != ".stl":
        np.testing.assert_array_equal(loaded.faces, mesh.faces)
    if suffix in (".ply", ".glb"):
        np.testing.assert_array_equal(loaded.visual.vertex_colors, mesh.vertex_colors)


@pytest.mark.oracle
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_igl_reads_our_files(suffix: str, dtype: type, tmp_path: Path) -> None:
    igl = pytest.importorskip("igl")
    mesh = make(dtype, "uint8 rgba")
    write_mesh(mesh, tmp_path / f"mesh{suffix}", suffix=suffix)
    vertices, faces = igl.read_triangle_mesh(str(tmp_path / f"mesh{suffix}"))
    np.testing.assert_array_equal(vertices, mesh.vertices)
    np.testing.assert_array_equal(faces, mesh.faces)


@pytest.mark.parametrize("name", ["mesh", "mesh.txt", ".ply", "mesh.ply.gz"])
def test_unknown_suffixes_are_rejected_by_all_functions(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(SMALL[".ply"])
    for read in (read_mesh, msb.open, msb.audit, msb.export):
        with pytest.raises(InputError, match="FILE_NOT_RECOGNISED") as caught:
            read(tmp_path / name)
        assert caught.value.file == str(tmp_path / name)


CONTENTS = {".ply": "PLY", ".off": "OFF", ".STL": "STL", ".glb": "GLB"}


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_content_of_another_format_is_recognised(tmp_path: Path, suffix: str, content: str) -> None:
    if suffix == content.lower():
        return
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(SMALL[content])
    with pytest.raises(MeshFileError, match=f"MESH_FILE_INVALID: .* {CONTENTS[content]}"):
        read_mesh(path)


def test_array_shapes_and_types_are_checked() -> None:
    vertices, faces = np.array(SQUARE), np.array(SQUARE_FACES)
    assert (
        Mesh(vertices, faces, np.zeros((4, 3), np.uint8), np.ones((2, 4), np.float32)).face_colors is not None
    )
    for wrong in (
        (vertices[:, :2], faces),
        (vertices.astype(np.int64), faces),
        (vertices, faces.astype(np.int32)),
        (vertices, faces.ravel()),
        (vertices, faces, np.zeros((3, 3), np.uint8)),
        (vertices, faces, np.zeros((4, 2), np.uint8)),
        (vertices, faces, np.zeros((4, 3))),
        (vertices, faces, None, np.zeros((4, 3), np.uint8)),
    ):
        with pytest.raises(MeshError, match="MESH_ARRAY"):
            Mesh(*wrong)


HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
POINTS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
WRITTEN = {
    "a.obj": (
        "# a quad first, then\\\n a comment\n"
        + "v 0 0 0\n" * 4
        + "f 1 2 3 4\n\nl 1 9\nf 1 9\nf 2/1 3/1 9/1\n",
        "line 11: .* 9; .* 1 to 4",
    ),
    "empty.obj": (
        "v 0 0 0\nf 1 2 3\n",
        "line 2: .* 2; .* 1 to 1",
    ),
    "a.off": (
        f"OFF\n# counts\n4 2 0\n{POINTS}4 0 1 2 3\n\n3 0 1 4 255 0 0\n",
        "line 10: .* 4; .* 0 to 3",
    ),
    "negative.off": (
        f"OFF 4 1 0\n{POINTS}3 0 -1 2\n",
        "line 6: .* -1; .* 0 to 3",
    ),
    "a.ply": (
        f"{HEADER}{POINTS}4 0 1 2 3\n3 0 1 7\n",
        "line 15: .* 7; .* 0 to 3",
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_invalid_indices_are_reported_with_their_line(name: str, tmp_path: Path) -> None:
    content, pattern = WRITTEN[name]
    path = tmp_path / name
    path.write_text(content)
    text = read_mesh(path).wrong_face
    assert re.match(pattern, text)
    for use in (msb.audit, msb.open, lambda path: msb.validate(path).findings[0].to_error(path)):
        try:
            reported = use(path)
        except MeshError as error:
            reported = error
        assert str(reported) == f"MESH_INDEX_OUT_OF_RANGE: {path}: {text}"


def test_binary_files_have_no_line_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    header = HEADER.replace("ascii", "binary_little_endian")
    path.write_bytes(header.encode() + bytes(48) + (b"\3" + bytes(8) + b"\7\0\0\0") * 2)
    assert read_mesh(path).wrong_face is None
    with pytest.raises(MeshError, match="INDEX_OUT_OF_RANGE"):
        msb.audit(path)
