"""What is written reads back, here and by other libraries."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.errors import InputError, MeshError, OutputError
from msb.meshes import MESH_SUFFIXES, Mesh, read_mesh, write_mesh, writing

BYTES = np.random.default_rng(1).integers(0, 2, (9, 4), dtype=np.uint8)
"""Only zeros and ones: the hardest bytes to tell from decimals in a text file."""

FLOATS = np.random.default_rng(2).random((9, 4), dtype=np.float32)
COLORS = {
    "none": None,
    "uint8 rgb": BYTES[:, :3].copy(),
    "uint8 rgba": BYTES,
    "float32 rgb": FLOATS[:, :3].copy(),
    "float32 rgba": FLOATS,
}


def make(dtype: type, colors: str = "none", face_colors: str = "none") -> Mesh:
    """Return nine vertices, one of them unused and two equal, and faces that are not in order."""
    vertices = np.random.default_rng(0).normal(size=(9, 3)).astype(dtype)
    vertices[3] = vertices[1]
    vertices[4] = [0, 1e-30, -1e30]
    faces = np.array([[7, 1, 0], [3, 2, 1], [5, 5, 6], [0, 1, 7], [7, 1, 0]])
    wanted = COLORS[face_colors]
    return Mesh(vertices, faces, COLORS[colors], None if wanted is None else wanted[: len(faces)])


def written(mesh: Mesh, suffix: str) -> bytes:
    stream = io.BytesIO()
    write_mesh(mesh, stream, suffix=suffix)
    return stream.getvalue()


def arrays(mesh: Mesh) -> list[NDArray[np.generic] | None]:
    return [array for array in vars(mesh).values() if not isinstance(array, tuple)]


def round_trip(mesh: Mesh, suffix: str, folder: Path) -> Mesh:
    """Write and read `mesh`; check that the arrays written are as before and the bytes the same each time."""
    before = [None if array is None else array.copy() for array in arrays(mesh)]
    path = folder / f"mesh{suffix}"
    write_mesh(mesh, path, suffix=suffix.upper())
    assert path.read_bytes() == written(mesh, suffix)
    for array, copy in zip(arrays(mesh), before, strict=True):
        np.testing.assert_array_equal(array, copy)
    return read_mesh(path)


def equal(array: NDArray[np.generic] | None, other: NDArray[np.generic] | None) -> bool:
    """Return whether both are None, or of one type and equal."""
    if array is None or other is None:
        return array is other
    return array.dtype == other.dtype and np.array_equal(array, other)


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb"])
def test_round_trip(suffix: str, dtype: type, colors: str, tmp_path: Path) -> None:
    mesh = make(dtype, colors)
    again = round_trip(mesh, suffix, tmp_path)
    stored = {".ply": dtype, ".obj": np.float64, ".off": np.float64, ".glb": np.float32}[suffix]
    assert equal(again.vertices, mesh.vertices.astype(stored))
    assert equal(again.faces, mesh.faces)
    expected = mesh.vertex_colors
    if suffix == ".obj" and colors.startswith("uint8"):
        expected = (COLORS[colors] / 255).astype(np.float32)
    if suffix == ".glb" and colors == "uint8 rgb":
        expected = np.insert(COLORS[colors], 3, 255, axis=1)
    assert equal(again.vertex_colors, expected)
    assert again.face_colors is None


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("suffix", [".ply", ".off"])
def test_round_trip_of_face_colors(suffix: str, colors: str, tmp_path: Path) -> None:
    mesh = make(np.float64, "uint8 rgba", colors)
    again = round_trip(mesh, suffix, tmp_path)
    assert equal(again.face_colors, mesh.face_colors)
    assert equal(again.vertex_colors, mesh.vertex_colors)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_round_trip_of_stl_gives_the_corners(dtype: type, tmp_path: Path) -> None:
    mesh = make(dtype, "uint8 rgb")
    again = round_trip(mesh, ".stl", tmp_path)
    assert equal(again.vertices, mesh.vertices[mesh.faces].reshape(-1, 3).astype(np.float32))
    assert again.vertex_colors is None


def test_stl_normals_are_unit_length_and_zero_for_no_area() -> None:
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0.0]])
    content = written(Mesh(vertices, np.array([[0, 1, 2], [2, 1, 0], [0, 1, 1]])), ".stl")
    normals = [struct.unpack_from("<3f", content, 84 + 50 * face) for face in range(3)]
    assert normals == [(0, 0, 1), (0, 0, -1), (0, 0, 0)]
    assert not content.lower().startswith(b"solid")


def test_rows_are_written_in_parts_without_a_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = make(np.float64, "uint8 rgba")
    whole = [written(mesh, suffix) for suffix in (".ply", ".obj", ".off")]
    monkeypatch.setattr(writing, "ROWS_AT_A_TIME", 2)
    monkeypatch.setattr("msb.meshes.ply.ROWS_AT_A_TIME", 2)
    assert [written(mesh, suffix) for suffix in (".ply", ".obj", ".off")] == whole


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_coordinates_that_are_not_finite_are_refused(suffix: str, value: float) -> None:
    mesh = make(np.float32)
    mesh.vertices[4, 1] = value
    stream = io.BytesIO()
    with pytest.raises(OutputError, match=r"OUTPUT_FORMAT_LIMIT: vertex 4 is not finite") as caught:
        write_mesh(mesh, stream, suffix=suffix)
    assert caught.value.pointer == "vertices[4]"
    assert stream.getvalue() == b""


@pytest.mark.parametrize("suffix", [".stl", ".glb"])
def test_coordinates_beyond_float32_are_refused_where_the_format_has_only_that(suffix: str) -> None:
    mesh = make(np.float64)
    mesh.vertices[2, 0] = 1e39
    with pytest.raises(OutputError, match=r"OUTPUT_FORMAT_LIMIT: vertex 2 does not fit float32"):
        written(mesh, suffix)


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
@pytest.mark.parametrize("index", [-1, 9])
def test_faces_that_use_no_vertex_are_refused(suffix: str, index: int) -> None:
    mesh = make(np.float32)
    mesh.faces[1, 2] = index
    with pytest.raises(
        MeshError, match=r"MESH_INDEX_OUT_OF_RANGE: face 1 is \[3, 2, -?\d\]; there are 9 vertices"
    ):
        written(mesh, suffix)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_a_mesh_without_faces(suffix: str, tmp_path: Path) -> None:
    mesh = Mesh(make(np.float64).vertices, np.zeros((0, 3), dtype=np.int64), BYTES)
    again = round_trip(mesh, suffix, tmp_path)
    assert equal(again.vertices, mesh.vertices)
    assert equal(again.faces, mesh.faces)


def test_glb_cannot_hold_a_mesh_without_faces() -> None:
    mesh = Mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(OutputError, match="OUTPUT_FORMAT_LIMIT: GLB cannot hold a mesh without faces"):
        written(mesh, ".glb")
    assert len(written(mesh, ".stl")) == 84


def test_a_target_that_cannot_be_written(tmp_path: Path) -> None:
    mesh = make(np.float32)
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE") as caught:
        write_mesh(mesh, tmp_path / "absent" / "mesh.ply", suffix=".ply")
    assert caught.value.file == str(tmp_path / "absent" / "mesh.ply")
    with pytest.raises(InputError, match="FILE_NOT_RECOGNISED"):
        write_mesh(mesh, tmp_path / "mesh.xyz", suffix=".xyz")
    assert not (tmp_path / "mesh.xyz").exists()


def description(content: bytes) -> dict[str, object]:
    """Return the JSON of a GLB."""
    (size,) = struct.unpack_from("<I", content, 12)
    found: dict[str, object] = json.loads(content[20 : 20 + size])
    return found


def test_glb_says_unlit_two_sided_and_bounds() -> None:
    mesh = make(np.float32, "uint8 rgb")
    content = written(mesh, ".glb")
    root = description(content)
    assert root["extensionsUsed"] == ["KHR_materials_unlit"]
    assert root["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    assert root["materials"][0]["doubleSided"] is True
    assert len(root["meshes"]) == len(root["meshes"][0]["primitives"]) == 1
    position, indices, color = root["accessors"]
    assert position["min"] == mesh.vertices.min(axis=0).tolist()
    assert position["max"] == mesh.vertices.max(axis=0).tolist()
    assert (indices["componentType"], indices["count"]) == (5125, 15)
    assert (color["componentType"], color["type"], color["normalized"]) == (5121, "VEC4", True)
    assert all(view["byteOffset"] % 4 == 0 for view in root["bufferViews"])
    assert len(content) % 4 == 0


@pytest.mark.parametrize("colors", ["none", "uint8 rgba", "float32 rgb", "float32 rgba"])
def test_pygltflib_reads_our_glb(colors: str, tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    mesh = make(np.float32, colors)
    write_mesh(mesh, tmp_path / "mesh.glb", suffix=".glb")
    loaded = pygltflib.GLTF2().load(tmp_path / "mesh.glb")
    blob = loaded.binary_blob()

    def array(number: int) -> NDArray[np.generic]:
        accessor = loaded.accessors[number]
        view = loaded.bufferViews[accessor.bufferView]
        dtype = {5121: "u1", 5125: "<u4", 5126: "<f4"}[accessor.componentType]
        return np.frombuffer(
            blob, dtype, offset=view.byteOffset, count=view.byteLength // np.dtype(dtype).itemsize
        )

    primitive = loaded.meshes[0].primitives[0]
    assert array(primitive.attributes.POSITION).reshape(-1, 3).tolist() == mesh.vertices.tolist()
    assert array(primitive.indices).reshape(-1, 3).tolist() == mesh.faces.tolist()
    if mesh.vertex_colors is not None:
        assert np.array_equal(array(primitive.attributes.COLOR_0), mesh.vertex_colors.ravel())


@pytest.mark.oracle
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb", ".stl"])
def test_trimesh_reads_ours(suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh", minversion="5")
    mesh = make(np.float32, "uint8 rgba")
    stream = io.BytesIO(written(mesh, suffix))
    # With materials trimesh moves vertex colours elsewhere.
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
def test_igl_reads_ours(suffix: str, dtype: type, tmp_path: Path) -> None:
    igl = pytest.importorskip("igl")
    mesh = make(dtype, "uint8 rgba")
    write_mesh(mesh, tmp_path / f"mesh{suffix}", suffix=suffix)
    vertices, faces = igl.read_triangle_mesh(str(tmp_path / f"mesh{suffix}"))
    np.testing.assert_array_equal(vertices, mesh.vertices)
    np.testing.assert_array_equal(faces, mesh.faces)
