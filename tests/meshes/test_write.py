"""What is written reads back, here and by other libraries."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.errors import OutputError
from msb.meshes import Mesh, write_mesh, writing
from msb.meshes.formats import Style

from .checks import BYTES, COLORS, equal, make, round_trip, written


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb"])
def test_types_of_what_is_read_back(suffix: str, dtype: type, colors: str, tmp_path: Path) -> None:
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
    if suffix == ".glb" and colors.startswith("float32"):
        assert again.vertex_colors.dtype == np.float32
        width = expected.shape[1]
        np.testing.assert_allclose(again.vertex_colors[:, :width], expected, rtol=0, atol=0.1 / 255)
    else:
        assert equal(again.vertex_colors, expected)
    assert again.face_colors is None


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("suffix", [".ply", ".off"])
def test_face_colors_keep_their_type(suffix: str, colors: str, tmp_path: Path) -> None:
    mesh = make(np.float64, "uint8 rgba", colors)
    again = round_trip(mesh, suffix, tmp_path)
    assert equal(again.face_colors, mesh.face_colors)
    assert equal(again.vertex_colors, mesh.vertex_colors)


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


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_a_mesh_without_faces(suffix: str, tmp_path: Path) -> None:
    mesh = Mesh(make(np.float64).vertices, np.zeros((0, 3), dtype=np.int64), BYTES)
    again = round_trip(mesh, suffix, tmp_path)
    assert equal(again.vertices, mesh.vertices)
    assert equal(again.faces, mesh.faces)


def test_glb_cannot_hold_a_mesh_without_faces() -> None:
    mesh = Mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(OutputError, match="OUTPUT_FORMAT_LIMIT"):
        written(mesh, ".glb")
    assert len(written(mesh, ".stl")) == 84


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
    position, color, indices = root["accessors"]
    assert position["min"] == mesh.vertices.min(axis=0).tolist()
    assert position["max"] == mesh.vertices.max(axis=0).tolist()
    assert (indices["componentType"], indices["count"]) == (5123, 15)
    assert (color["componentType"], color["type"], color["normalized"]) == (5123, "VEC4", True)
    assert all(view["byteOffset"] % 4 == 0 for view in root["bufferViews"])
    assert len(content) % 4 == 0


@pytest.mark.parametrize("colors", ["none", "uint8 rgba", "float32 rgb", "float32 rgba"])
def test_pygltflib_reads_our_glb(colors: str, tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    mesh = make(np.float32, colors)
    write_mesh(mesh, tmp_path / "mesh.glb", suffix=".glb", style=Style("srgb"))
    loaded = pygltflib.GLTF2().load(tmp_path / "mesh.glb")
    blob = loaded.binary_blob()

    def array(number: int) -> NDArray[np.generic]:
        accessor = loaded.accessors[number]
        view = loaded.bufferViews[accessor.bufferView]
        dtype = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor.componentType]
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
    stream = io.BytesIO()
    write_mesh(mesh, stream, suffix=suffix, style=Style("srgb"))
    stream.seek(0)
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
