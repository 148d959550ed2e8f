"""`msb export`: settings, forms, exit statuses. Its text is in tests/snapshots."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import msb as library
from tests.adapters import models
from tests.adapters.models import GOLDEN, write_model
from tests.adapters.test_bad_models import gaussians
from tests.cli.conftest import Here, here, on_terminal
from tests.conftest import ROOT

__all__ = ["here"]

RING = GOLDEN / "two_dts" / "ring_solid" / "checkpoint"
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"


def test_the_command_writes_the_asset_of_the_function(here: Here, tmp_path: Path) -> None:
    target = tmp_path / "ring.triasset"
    result = here("export", "--json", "-", RING, target)
    assert (result.status, result.err) == (0, "")
    assert library.load(target).manifest == library.export(RING).manifest
    assert (result.json["schema"], result.json["warnings"]) == ("msb.export/1", [])
    assert result.json["manifest"]["settings"]["rasterizer"] == {"value": "3D", "source": "config"}
    assert here("validate", "-q", target).status == 0


def test_the_size_of_a_folder_counts_all_files(here: Here, tmp_path: Path) -> None:
    (line,) = here("export", "-q", "--form", "folder", CHECKPOINT, tmp_path / "c.triasset").out.splitlines()
    files = [path for path in (tmp_path / "c.triasset").rglob("*") if path.is_file()]
    assert line.endswith(f", {sum(path.stat().st_size for path in files):,} bytes")


def test_the_output_is_named_like_the_input(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert here("export", "-q", ROOT / "data_stubs" / "models" / "pebble" / "two_dts").status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["two_dts.triasset"]
    here("export", ROOT / "data_stubs" / "models" / "pebble" / "two_dts").ends(2, "OUTPUT_EXISTS: ")


def test_set_overrides_settings_and_is_recorded(here: Here, tmp_path: Path) -> None:
    target = tmp_path / "a.triasset"
    line = ("--set", "ste_threshold=none", "--set", "gamma=20", "--set", "back_culling=yes", RING, target)
    assert here("export", *line).status == 0
    settings = library.load(target).manifest.settings
    stored = {name: (setting.value, setting.source) for name, setting in settings.items()}
    assert stored["ste_threshold"] == (None, "flag")
    assert stored["gamma"] == (20.0, "flag")
    assert stored["back_culling"] == (True, "flag")
    for text, code in (("gama=2", "SETTING_UNKNOWN"), ("gamma=two", "SETTING_VALUE"), ("gamma", "USAGE")):
        here("export", "--force", "--set", text, RING, target).ends(2, f"{code}: ")


def test_exit_statuses_of_failed_exports(here: Here, tmp_path: Path) -> None:
    values = models.mesh_splatting()
    values["triangles_points"][values["_triangle_indices"][0, 0], 1] = np.nan
    model = write_model(tmp_path / "nan", "mesh_splatting", values)
    target = tmp_path / "a.triasset"
    for args, status, code in (
        ([tmp_path / "nothing", target], 3, "FILE_NOT_FOUND"),
        (["--method", "nerf", RING, target], 2, "USAGE"),
        (["--method", "diffsoup", RING, target], 3, "CHECKPOINT_METHOD"),
        ([RING, "/proc/nowhere/a.triasset"], 3, "OUTPUT_UNWRITABLE"),
        ([model, target], 3, "CHECKPOINT_NONFINITE"),
    ):
        here("export", *args).ends(status, f"{code}: ")
        assert not target.exists()
    assert here("audit", "--json", "-", model).json["counts"]["nonfinite_faces"] > 0  # the audit accepts NaN


def test_gaussians_are_exported_but_are_no_mesh(here: Here, tmp_path: Path) -> None:
    gaussians(tmp_path / "gs" / "point_cloud" / "iteration_7000" / "point_cloud.ply", 3)
    here("export", tmp_path / "gs", tmp_path / "gs.triasset")
    for arguments in (["audit"], ["trial"], ["convert", "{}", "a.glb"], ["repair", "{}", "a.glb"]):
        given = [str(tmp_path / "gs.triasset" if word == "{}" else word) for word in arguments]
        given += [] if len(given) > 1 else [str(tmp_path / "gs.triasset")]
        here(*given).ends(4, "UNSUPPORTED_METHOD: ")
    shown = here("info", "--json", "-", tmp_path / "gs.triasset")
    assert (shown.status, shown.json["manifest"]["primitive"]) == (4, "gaussian")


def test_a_missing_config_is_a_warning(here: Here, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting", tmp_path / "bare")
    (tmp_path / "bare" / "cfg_args").unlink()
    result = here("export", tmp_path / "bare", tmp_path / "a.triasset")
    assert (result.status, result.err.count("\n")) == (0, 1)
    assert result.err.startswith("warning: CHECKPOINT_CONFIG_MISSING: ")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="pseudo-terminals are POSIX")
def test_stages_have_bars_on_a_terminal(tmp_path: Path) -> None:
    output = on_terminal("export", RING, tmp_path / "a.triasset")
    assert all(stage in output for stage in ("hashing the source", "hashing buffers", "writing"))
