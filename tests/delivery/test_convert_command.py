"""`msb convert`: vertices, faces, colours, axes, forms, engines and exit statuses.

The messages are in tests/snapshots.
"""

import re
from pathlib import Path

import numpy as np
import pytest

import msb as library
from msb.asset.texture import srgb_to_linear
from msb.meshes import read_mesh
from tests.adapters.models import GOLDEN
from tests.cli.conftest import Here, here
from tests.conftest import ROOT
from tests.meshes.glb_json import read_positions

__all__ = ["here"]

RING = GOLDEN / "two_dts" / "ring_solid" / "checkpoint"
COLMAP = ROOT / "data_stubs" / "models" / "walled" / "mesh_splatting"
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl red\nf 1/1/1 2/1/1 3/1/1\n"


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".glb"])
def test_vertices_faces_and_colours_are_kept_in_order(
    here: Here, demo_asset: Path, tmp_path: Path, suffix: str
) -> None:
    target = tmp_path / "new" / f"demo{suffix}"
    result = here("convert", demo_asset, target)
    asset, mesh = library.load(demo_asset), read_mesh(target)
    corners = asset.buffers["positions"][asset.buffers["indices"]]
    assert np.array_equal(mesh.vertices[mesh.faces].astype(np.float32), corners)
    assert f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces" in result.out
    assert "opacity" in result.err  # a mesh file cannot store it
    if suffix == ".stl":
        return
    assert np.array_equal(mesh.faces, asset.buffers["indices"])
    colors = mesh.vertex_colors / (255 if mesh.vertex_colors.dtype == np.uint8 else 1)
    expected = np.clip(0.28209479177387814 * asset.buffers["f_dc"] + 0.5, 0, 1)
    assert np.abs(colors[:, :3] - expected).max() <= 0.5 / 255 + 1e-6


def test_both_forms_of_an_asset_keep_everything(here: Here, tmp_path: Path) -> None:
    source = GOLDEN / "meshes" / "synthetic_splat_small.ply"
    steps = [source, *(tmp_path / name for name in ("a.triasset", "b.triasset", "c.triasset", "d.ply"))]
    options: list[list[str]] = [[], ["--form", "folder"], [], []]
    for before, after, extra in zip(steps[:-1], steps[1:], options, strict=True):
        assert here("convert", before, after, *extra).status == 0
    assert (tmp_path / "a.triasset").read_bytes() == (tmp_path / "c.triasset").read_bytes()
    first, last = read_mesh(source), read_mesh(steps[-1])
    assert np.array_equal(first.vertices, last.vertices)
    assert np.array_equal(first.faces, last.faces)
    origin = library.load(tmp_path / "a.triasset").manifest.source.files[0]
    assert (origin.path, origin.byte_length) == (source.name, source.stat().st_size)


def test_a_folder_is_converted_with_its_layout(here: Here, tmp_path: Path) -> None:
    source = ROOT / "data_stubs" / "models" / "pebble"
    assert here("convert", "--to", "triasset", source, tmp_path / "out").status == 0
    models = {path.name for path in source.iterdir()}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{name}.triasset" for name in models}
    here("convert", "--to", "triasset", source, tmp_path / "out").ends(2, "OUTPUT_EXISTS: ")
    here("convert", "--to", "exe", source, tmp_path / "new").ends(2, "USAGE: ")
    here("convert", source, tmp_path / "a.glb").ends(2, "USAGE: ")
    for name in ("a.obj", "a.off"):  # both would become a.glb
        (tmp_path / "two").mkdir(exist_ok=True)
        here("convert", "-q", source / "two_dts", tmp_path / "two" / name)
    here("convert", tmp_path / "two", tmp_path / "new").ends(2, "USAGE: ")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("up", "direction"), [("-y", (0, -1, 0)), ("+z", (0, 0, 1)), ("-x", (-1, 0, 0))])
def test_up_rotates_the_axis_to_y_without_mirroring(
    here: Here, tmp_path: Path, up: str, direction: tuple[int, int, int]
) -> None:
    rows = np.array([direction, (0, 0, 0), (1, 2, 3), (4, 5, 7)], float)
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "in.off").write_text(f"OFF\n4 2 0\n{text}\n3 0 1 2\n3 1 2 3\n")
    assert here("convert", tmp_path / "in.off", tmp_path / "out.obj", f"--up={up}").status == 0
    lines = (tmp_path / "out.obj").read_text().splitlines()
    turned = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert np.array_equal(read_mesh(tmp_path / "out.obj").vertices, rows)  # in the frame of the input
    assert turned[0].tolist() == [0, 1, 0]
    assert np.linalg.det(turned[[0, 2, 3]]) == pytest.approx(np.linalg.det(rows[[0, 2, 3]]))


def test_a_colmap_model_is_rotated_upright(here: Here, tmp_path: Path) -> None:
    frames = {}
    for name in ("m.glb", "m.ply"):
        assert here("convert", COLMAP, tmp_path / name).status == 0
        frames[name] = here("info", "--json", "-", tmp_path / name).json["manifest"]["coordinate_frame"]["up"]
    assert frames == {"m.glb": "-y", "m.ply": "unknown"}
    turned, stored = read_positions(tmp_path / "m.glb"), read_mesh(tmp_path / "m.ply").vertices
    np.testing.assert_allclose(turned, stored * (1, -1, -1), atol=1e-6)


def test_linear_colours(here: Here, tmp_path: Path) -> None:
    text = "COFF\n3 1 0\n0 0 0 255 128 0\n1 0 0 255 128 0\n0 1 0 255 128 0\n3 0 1 2\n"
    (tmp_path / "in.off").write_text(text)
    assert here("convert", "--color", "linear", tmp_path / "in.off", tmp_path / "out.ply").status == 0
    colors = read_mesh(tmp_path / "out.ply").vertex_colors
    assert colors[0, :3] == pytest.approx([1.0, 0.2158605, 0.0], abs=1e-6)


@pytest.mark.slow
def test_a_file_for_the_web_is_smaller_and_has_50_db(here: Here, demo_asset: Path, tmp_path: Path) -> None:
    plain, web = tmp_path / "plain.glb", tmp_path / "web.glb"
    assert here("convert", demo_asset, plain, "--for", "unreal").status == 0
    result = here("convert", demo_asset, web, "--for", "web")
    assert float(re.search(r"([\d.]+) dB", result.out)[1]) >= 50
    assert web.stat().st_size < plain.stat().st_size / 2
    assert b"extensionsRequired" not in plain.read_bytes()
    assert b"extensionsRequired" in web.read_bytes()


def test_ignored_data_is_listed(here: Here, tmp_path: Path) -> None:
    source = tmp_path / "t.obj"
    source.write_text(TRIANGLE)
    ignored, up = here("convert", source, tmp_path / "t.glb").err.splitlines()
    assert all(word in ignored for word in ("normals", "UVs", "materials"))
    assert "--up=-y" in up
    assert here("convert", source, tmp_path / "t.glb", "-f", "--up=+y").err.count("\n") == 1
    assert "MESH_FILE_LEFT_OUT" in here("convert", source, tmp_path / "t.triasset").err
    assert here("audit", source).err == ""  # an audit reads triangles only


def test_invalid_arguments_are_rejected(here: Here, demo_asset: Path, tmp_path: Path) -> None:
    for name, *options in (
        ("x.xyz",),
        ("x.glb", "--form", "folder"),
        ("x.triasset", "--color", "srgb"),
        ("x.glb", "--up=y"),
        ("x.glb", "--scale", "0"),
        ("x.glb", "--known-distance", "0,0,0", "0,0,0", "1m"),
        ("x.glb", "--known-distance", "0,0,0", "1,0,0", "1"),
        ("x.glb", "--scale", "2", "--known-distance", "0,0,0", "1,0,0", "1m"),
        ("x.ply", "--for", "web"),
    ):
        here("convert", demo_asset, tmp_path / name, *options).ends(2, "USAGE: ")
    (tmp_path / "nan.off").write_text("OFF\n3 1 0\nnan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    nan = here("convert", tmp_path / "nan.off", tmp_path / "nan.triasset")
    nan.ends(3, f"TRIASSET_VALUE_NONFINITE: {tmp_path / 'nan.off'}: ")
    assert [path.name for path in tmp_path.iterdir()] == ["nan.off"]


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".triasset"])
def test_a_few_faces_that_are_not_finite_are_left_out(here: Here, tmp_path: Path, suffix: str) -> None:
    (tmp_path / "nan.off").write_text("OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\nnan 0 0\n3 0 1 2\n3 0 1 3\n")
    result = here("convert", tmp_path / "nan.off", tmp_path / f"a{suffix}")
    assert result.status == 0
    assert "not finite" in result.err
    asset = library.open(tmp_path / f"a{suffix}")
    assert (asset.manifest.face_count, asset.manifest.vertex_count) == (1, 3)


def test_the_official_file_equals_that_of_the_exporter(here: Here, tmp_path: Path) -> None:
    asset = tmp_path / "ring.triasset"
    assert here("export", "--quiet", RING, asset).status == 0
    assert here("convert", "--official", asset, tmp_path / "ring.glb").status == 0
    ours, theirs = read_mesh(tmp_path / "ring.glb"), read_mesh(RING / "glb" / "60000.glb")
    # The official file stores sRGB values, but is read as linear light, as glTF specifies.
    stored = np.rint(255 * srgb_to_linear(theirs.vertex_colors[:, :3].astype(float)))
    np.testing.assert_array_equal(ours.vertex_colors[:, :3], stored)
    assert here("convert", asset, tmp_path / "standard.glb").status == 0
    assert len(read_mesh(tmp_path / "standard.glb").faces) == len(theirs.faces) // 2
    here("convert", "--official", asset, tmp_path / "ring.off").ends(2, "NAME_UNKNOWN: ")
    again = here("convert", "--official", tmp_path / "ring.glb", tmp_path / "again.glb")
    again.ends(4, "UNSUPPORTED_METHOD: ")


def test_the_official_folder_of_diffsoup_is_a_model(here: Here, tmp_path: Path) -> None:
    asset = tmp_path / "ico.triasset"
    here("export", "--quiet", GOLDEN / "diffsoup" / "ico_l2_white" / "checkpoint", asset)
    assert here("convert", "--official", asset, tmp_path / "web").status == 0
    assert library.export(tmp_path / "web").manifest.method == "diffsoup"
    assert here("convert", asset, tmp_path / "ico.glb").status == 4
