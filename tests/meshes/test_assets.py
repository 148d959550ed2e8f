"""Convert meshes for file formats: colours, shared vertices, and the up axis."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.asset.look import up_axis
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh, fit_to_format, mesh_from_asset, without_bad_faces
from msb.meshes.transform import rotate_axis
from tests.conftest import ROOT, TETRAHEDRON
from tests.meshes.glb_json import read_positions

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
POINTS = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)
COLORS = np.arange(12, dtype=np.uint8).reshape(4, 3)


def volume(mesh: Mesh) -> float:
    """Return six times the signed volume. Mirroring changes its sign, but rotation does not."""
    a, b, c = (mesh.vertices[column].astype(float) for column in mesh.faces.T)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum())


@pytest.mark.parametrize("up", AXES)
def test_a_glb_is_rotated_upright_and_otherwise_unchanged(up: str, tmp_path: Path) -> None:
    mesh = Mesh(POINTS, TETRAHEDRON[1].astype(np.int64), COLORS, up=up)
    path = tmp_path / "up.glb"
    msb.save(asset_from_mesh(mesh), path)
    again = read_mesh(path)
    stored = read_positions(path)
    assert np.array_equal(rotate_axis(stored, "+y", up), POINTS)
    assert np.array_equal(stored[:, 1], POINTS[:, "xyz".index(up[1])] * (1 if up[0] == "+" else -1))
    assert np.array_equal(again.vertices, POINTS)  # in the frame of the capture
    assert np.array_equal(again.vertex_colors[:, :3], COLORS)
    assert volume(again) == pytest.approx(volume(mesh), rel=1e-6)
    assert volume(replace(mesh, vertices=stored)) == pytest.approx(volume(mesh), rel=1e-6)
    assert (again.up, up_axis(msb.open(path))) == (up, up)
    assert np.array_equal(mesh_from_asset(msb.open(path)).vertices, again.vertices)  # not rotated twice
    for suffix in (".ply", ".obj", ".off"):  # these define no up axis
        assert np.array_equal(fit_to_format(mesh, suffix).vertices, POINTS)


@pytest.mark.parametrize(("model", "up"), [("walled", "-y"), ("pebble", "+z")])
@pytest.mark.parametrize("method", ["two_dts", "triangle_splatting", "mesh_splatting"])
def test_models_of_colmap_and_nerf_synthetic_scenes_are_rotated_upright(
    model: str, up: str, method: str, tmp_path: Path
) -> None:
    asset = msb.open(ROOT / "data_stubs" / "models" / model / method)
    assert asset.manifest.coordinate_frame.up == up
    msb.save(asset, tmp_path / "a.glb")
    expected = rotate_axis(mesh_from_asset(asset).vertices, up)
    assert np.array_equal(read_positions(tmp_path / "a.glb"), expected)
    assert np.array_equal(read_mesh(tmp_path / "a.glb").vertices, mesh_from_asset(asset).vertices)


def test_a_mesh_with_unknown_up_axis_is_not_rotated() -> None:
    mesh = Mesh(POINTS, TETRAHEDRON[1].astype(np.int64))
    assert fit_to_format(mesh, ".glb").vertices is mesh.vertices
    assert asset_from_mesh(mesh).manifest.coordinate_frame.up == "unknown"


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".glb"])
def test_as_held_equals_the_mesh_read_from_the_file(suffix: str, tmp_path: Path) -> None:
    faces = TETRAHEDRON[1].astype(np.int64)
    mesh = Mesh(POINTS / 3, faces, None, np.arange(3 * len(faces), dtype=np.uint8).reshape(-1, 3), up="-y")
    held = fit_to_format(mesh, suffix)
    path = tmp_path / f"a{suffix}"
    with path.open("wb") as file:
        msb.meshes.write_mesh(held, file, suffix=suffix)
    again = read_mesh(path)
    stored = read_positions(path) if suffix == ".glb" else again.vertices
    assert np.array_equal(stored, held.vertices)
    assert np.array_equal(again.faces, held.faces)
    assert (len(held.vertices) == 12) is (suffix in (".obj", ".stl", ".glb"))


def test_invalid_indices_are_rejected_before_vertices_are_split() -> None:
    mesh = replace(Mesh(POINTS, TETRAHEDRON[1].astype(np.int64)), faces=np.array([[0, 1, 9]]))
    with pytest.raises(msb.MsbError, match="INDEX_OUT_OF_RANGE"):
        fit_to_format(mesh, ".stl")


def test_faces_with_coordinates_that_are_not_finite_are_left_out() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0], [5, 5, 5], [0, np.inf, 0]])
    colors = np.arange(18, dtype=np.uint8).reshape(6, 3)
    mesh = Mesh(vertices, np.array([[0, 1, 3], [0, 1, 2]]), colors)
    kept, count = without_bad_faces(mesh)
    assert (count, kept.faces.tolist()) == (1, [[0, 1, 2]])
    assert kept.vertices.tolist() == vertices[[0, 1, 2, 4]].tolist()  # an unused vertex stays
    assert kept.vertex_colors is not None
    assert kept.vertex_colors.tolist() == colors[[0, 1, 2, 4]].tolist()
    only = Mesh(vertices, mesh.faces[:1])
    assert without_bad_faces(only) == (only, 0)
