"""`msb export`, `msb convert --official` and audits of checkpoints, as users meet them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import msb as library
from msb.asset.texture import srgb_to_linear
from msb.meshes import read_mesh
from tests.adapters import models
from tests.adapters.models import GOLDEN, write_model
from tests.adapters.test_bad_models import gaussians
from tests.cli.conftest import Msb, on_terminal
from tests.conftest import ROOT

RING = GOLDEN / "two_dts" / "ring_solid" / "checkpoint"
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"


@pytest.mark.slow
def test_export_says_what_it_made_and_where_settings_come_from(msb: Msb, tmp_path: Path) -> None:
    target = tmp_path / "ring.triasset"
    result = msb("export", RING, target)
    assert (result.status, result.err) == (0, "")
    first, header, *rows = result.out.splitlines()
    assert first.startswith(f"{target}: 2DTS, triangle soup, 11,952 vertices, 3,984 faces, SH degree 0, ")
    assert header.split() == ["Setting", "Value", "From"]
    assert rows[0].split() == ["rasterizer", "3D", "config"]
    assert ["ste_threshold", "0.3", "config"] in [row.split() for row in rows]
    msb("validate", target, status=0)
    assert library.load(target).manifest == library.export(RING).manifest


@pytest.mark.slow
def test_export_json_and_quiet(msb: Msb, tmp_path: Path) -> None:
    result = msb("export", "--json", "-", CHECKPOINT, tmp_path / "a.triasset")
    assert (result.status, result.err) == (0, "")
    assert result.json["schema"] == "msb.export/1"
    assert result.json["warnings"] == []
    assert result.json["manifest"]["settings"]["sh_degree"] == {"value": 1, "source": "checkpoint"}
    assert len(msb("export --quiet", CHECKPOINT, tmp_path / "b.triasset").out.splitlines()) == 1
    said = msb("export -q --form folder", CHECKPOINT, tmp_path / "c.triasset").out
    assert (tmp_path / "c.triasset" / "manifest.json").is_file()
    files = [path for path in (tmp_path / "c.triasset").rglob("*") if path.is_file()]
    assert said.endswith(f", {sum(path.stat().st_size for path in files):,} bytes\n")


@pytest.mark.slow
def test_export_set_overrides_and_checks(msb: Msb, tmp_path: Path) -> None:
    target = tmp_path / "a.triasset"
    msb("export --set ste_threshold=none --set gamma=20 --set back_culling=yes", RING, target, status=0)
    stored = {k: (s.value, s.source) for k, s in library.load(target).manifest.settings.items()}
    assert stored["ste_threshold"] == (None, "flag")
    assert stored["gamma"] == (20.0, "flag")
    assert stored["back_culling"] == (True, "flag")
    for text, line in (
        ("gama=2", 'SETTING_UNKNOWN: two_dts has no setting "gama"; it has rasterizer, sh_degree, gamma, '),
        ("gamma=two", "SETTING_VALUE: setting gamma is 'two'; it must be a number"),
        ("gamma", 'USAGE: --set takes name=value; "gamma" has no "="'),
    ):
        msb("export --force --set", text, RING, target).ends(2, line)


@pytest.mark.slow
def test_statuses_of_what_cannot_be_exported(msb: Msb, tmp_path: Path) -> None:
    gaussians(tmp_path / "gs" / "point_cloud" / "iteration_7000" / "point_cloud.ply", 3)
    target = tmp_path / "a.triasset"
    for args, status, line in (
        ([tmp_path / "gs", target], 4, "UNSUPPORTED_METHOD: "),
        ([tmp_path / "nothing", target], 3, "FILE_NOT_FOUND: "),
        ([tmp_path, tmp_path / "a.ply"], 2, 'USAGE: OUT is "a.ply"; it must end in .triasset'),
        (["--method", "nerf", RING, target], 2, 'USAGE: there is no method "nerf"; there are two_dts, '),
        (["--method", "diffsoup", RING, target], 3, "CHECKPOINT_METHOD: "),
        ([RING, "/proc/nowhere/a.triasset"], 3, "OUTPUT_UNWRITABLE: "),
    ):
        msb("export", *args).ends(status, line)
    target.write_text("mine")
    msb("export", RING, target).ends(2, "OUTPUT_EXISTS: ")
    assert target.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.triasset", "gs"]


@pytest.mark.slow
def test_progress_bars_on_a_terminal_only(tmp_path: Path) -> None:
    shown = on_terminal("export", RING, tmp_path / "a.triasset")
    for stage in ("hashing the source", "hashing buffers", "writing"):
        assert stage in shown


@pytest.mark.slow
def test_convert_official(msb: Msb, tmp_path: Path) -> None:
    asset = tmp_path / "ring.triasset"
    msb("export", "--quiet", RING, asset)
    result = msb("convert", "--official", asset, tmp_path / "ring.glb")
    assert (result.status, result.err) == (0, "")
    assert "ring.glb" in result.out
    ours, theirs = read_mesh(tmp_path / "ring.glb"), read_mesh(RING / "glb" / "60000.glb")
    # The official file holds sRGB without a word, so it is read as the linear light that glTF says it is.
    stored = np.rint(255 * srgb_to_linear(theirs.vertex_colors[:, :3].astype(float)))
    np.testing.assert_array_equal(ours.vertex_colors[:, :3], stored)
    msb("convert", asset, tmp_path / "standard.glb", status=0)
    assert len(read_mesh(tmp_path / "standard.glb").faces) == len(theirs.faces) // 2
    for args, status, line in (
        ([asset, tmp_path / "ring.off"], 2, "NAME_UNKNOWN: "),
        (["--up=-y", asset, tmp_path / "up.glb"], 2, "USAGE: --up does not go with --official"),
        ([tmp_path / "ring.glb", tmp_path / "again.glb"], 4, "UNSUPPORTED_METHOD: "),
    ):
        msb("convert --official", *args).ends(status, line)


@pytest.mark.slow
def test_convert_official_folder_of_diffsoup_and_no_standard_tier(msb: Msb, tmp_path: Path) -> None:
    asset = tmp_path / "ico.triasset"
    msb("export", "--quiet", GOLDEN / "diffsoup" / "ico_l2_white" / "checkpoint", asset)
    msb("convert", "--official", asset, tmp_path / "web", status=0)
    assert library.export(tmp_path / "web").manifest.method == "diffsoup"
    msb("convert", asset, tmp_path / "ico.glb", status=4)


@pytest.mark.slow
def test_audit_takes_checkpoints(msb: Msb, tmp_path: Path) -> None:
    result = msb("audit", "--json", "-", RING, status=0)
    assert (result.json["method"], result.json["counts"]["faces"]) == ("two_dts", 3984)
    file = RING / "ckpt" / "60000.ckpt"
    assert msb("audit", "--json", "-", file).json["counts"] == result.json["counts"]
    ply = msb("audit", "--json", "-", RING / "point_cloud" / "60000.ply").json
    assert ply["counts"]["faces"] < 3984  # the official PLY leaves out what STE hides
    nasty = GOLDEN / "mesh_splatting" / "nasty_topology_sh0"
    found = msb("audit", "--json", "-", nasty).json  # a folder with two checkpoints
    assert [item["counts"]["faces"] for item in found] == [1301, 1301]
    assert [item["method"] for item in found] == ["mesh_splatting", "triangle_splatting_plus"]
    gaussians(tmp_path / "point_cloud" / "iteration_1" / "point_cloud.ply", 3)
    msb("audit", tmp_path).ends(4, "UNSUPPORTED_METHOD: ")


@pytest.mark.slow
def test_audit_counts_a_vertex_that_is_nan_and_export_refuses_it(msb: Msb, tmp_path: Path) -> None:
    values = models.mesh_splatting()
    values["triangles_points"][values["_triangle_indices"][0, 0], 1] = np.nan
    folder = write_model(tmp_path / "run", "mesh_splatting", values)
    assert msb("audit", "--json", "-", folder).json["counts"]["nonfinite_faces"] > 0
    msb("export", folder, tmp_path / "a.triasset").ends(3, "CHECKPOINT_NONFINITE: ")
    assert not (tmp_path / "a.triasset").exists()


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["two_dts/ring_solid", "diffsoup/ico_l2_white"])
def test_validate_judges_the_asset_that_would_be_made(msb: Msb, folder: str, tmp_path: Path) -> None:
    msb("validate", GOLDEN / folder / "checkpoint", status=0)
    values = models.triangle_splatting()
    values["sigma"][0] = np.nan
    bad = write_model(tmp_path, "triangle_splatting", values)
    result = msb("validate", bad)
    assert (result.status, "CHECKPOINT_NONFINITE" in result.out) == (1, True)


def test_a_warning_says_that_it_is_one_and_what_follows(msb: Msb, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting", tmp_path / "bare")
    (tmp_path / "bare" / "cfg_args").unlink()
    result = msb("export", "bare", cwd=tmp_path, status=0)
    assert result.err == (
        "warning: CHECKPOINT_CONFIG_MISSING: bare: cfg_args is not there, so the background used in training "
        "is not known; where something is drawn, --background COLOR gives it\n"
    )
