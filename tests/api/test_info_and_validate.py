"""`msb info` and `msb validate`: JSON, codes and exit statuses. Their text is in tests/snapshots."""

import json
from pathlib import Path

import numpy as np
import pytest

import msb as library
from msb.asset.texture import Sampler
from msb.errors import explained_codes
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from tests.adapters import models
from tests.adapters.models import GOLDEN, write_model
from tests.cli.conftest import Here, here
from tests.conftest import ROOT

__all__ = ["here"]


@pytest.mark.parametrize("path", ["data_stubs/checkpoint", "tests/golden/meshes/synthetic_splat_small.ply"])
def test_info_reads_meshes_and_checkpoints(here: Here, path: str) -> None:
    document = here("info", "--json", "-", path).json
    assert (document["schema"], document["path"]) == ("msb.info/1", path)
    assert document["manifest"]["face_count"] > 0
    assert here("info", path).status == 0


def test_the_opened_checkpoint_in_a_folder_is_named(here: Here) -> None:
    place = ROOT / "data_stubs"
    (note,) = here("info", place).err.splitlines()
    assert note.startswith("note: ")
    assert note.endswith(str(place / "checkpoint"))
    assert here("info", place / "checkpoint").err == ""


def test_info_describes_textures_and_how_they_are_read(here: Here, tmp_path: Path) -> None:
    images = (np.zeros((4, 8, 3), np.uint8), np.zeros((2, 2, 4), np.uint8), np.zeros((4, 8, 3), np.uint8))
    sampler = Sampler("nearest", mipmaps=False, wrap_v="clamp", alpha_cutoff=0.5)
    faces, textures = np.zeros((1, 3), np.int64), np.zeros(1, np.uint32)
    points = np.zeros((3, 3), np.float32)
    mesh = Mesh(
        points, faces, vertex_uvs=points[:, :2], textures=images, face_textures=textures, sampler=sampler
    )
    library.save(asset_from_mesh(mesh), tmp_path / "a.triasset")
    data = here("info", "--json", "-", tmp_path / "a.triasset").json
    assert data["textures"][1] == {"name": "texture.1", "width": 2, "height": 2, "channels": 4}
    assert data["manifest"]["appearance"]["alpha_cutoff"] == 0.5
    text = " ".join(here("info", tmp_path / "a.triasset").out.split())
    assert all(word in text for word in ("2 of 8 x 4", "nearest", "clamp along v"))


def test_info_marks_a_default_background(here: Here, tmp_path: Path) -> None:
    values = models.triangle_splatting()
    model = write_model(tmp_path, "triangle_splatting", values)
    stated, unknown = here("info", "data_stubs/models/walled/triangle_splatting"), here("info", model)
    rows = [[line.split() for line in each.out.splitlines()] for each in (stated, unknown)]
    assert ["background", "black"] in rows[0]
    assert any(row[:3] == ["background", "black", "(not"] for row in rows[1])


def test_validate_of_a_good_asset(here: Here, demo_asset: Path) -> None:
    data = here("validate", "--json", "-", demo_asset).json
    about = {"schema": "msb.validate/1", "path": str(demo_asset), "tool_version": library.__version__}
    assert data == {**about, "valid": True, "findings": [], "truncated": False}


def test_validate_lists_errors_first_and_limits_their_number(
    here: Here, demo_asset: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bad.triasset"
    library.save(library.load(demo_asset), path, form="folder")
    positions = np.fromfile(path / "buffers" / "positions.bin", "<f4")
    positions[4] = np.nan
    positions.tofile(path / "buffers" / "positions.bin")
    result = here("validate", "--json", "-", path)
    findings = {item["code"]: item for item in result.json["findings"]}
    assert (result.status, result.json["valid"]) == (1, False)
    assert findings["TRIASSET_DAMAGED"]["pointer"] == "/buffers/positions/sha256"
    assert findings["TRIASSET_VALUE_NONFINITE"]["severity"] == "error"
    manifest = json.loads((path / "manifest.json").read_text())
    manifest |= {f"key{number}": 0 for number in range(2000)} | {"sh_degree": 7}
    (path / "manifest.json").write_text(json.dumps(manifest))
    report = here("validate", "--json", "-", path).json
    assert (report["truncated"], len(report["findings"])) == (True, 1000)
    assert report["findings"][0]["code"] == "TRIASSET_FIELD"
    assert len(here("validate", path).out.splitlines()) < 200


def test_degenerate_faces_are_infos_and_status_0(here: Here, tmp_path: Path) -> None:
    mesh = tmp_path / "m.off"
    mesh.write_text("OFF\n5 4 0\n0 0 0\n1 0 0\n0 1 0\n2 0 0\n9 9 9\n3 0 1 2\n3 2 1 0\n3 0 1 3\n3 0 0 1\n")
    result = here("validate", "--json", "-", mesh)
    assert result.status == 0
    assert {(item["code"], item["value"]) for item in result.json["findings"]} == {
        ("TRIASSET_FACE_DUPLICATE", 1),
        ("TRIASSET_FACE_REPEATED_INDEX", 1),
        ("TRIASSET_FACE_ZERO_AREA", 1),
        ("TRIASSET_VERTEX_UNREFERENCED", 1),
    }
    assert {item["severity"] for item in result.json["findings"]} == {"info"}


@pytest.mark.parametrize("folder", ["two_dts/ring_solid", "diffsoup/ico_l2_white"])
def test_validate_checks_the_converted_asset(here: Here, folder: str, tmp_path: Path) -> None:
    assert here("validate", GOLDEN / folder / "checkpoint").status == 0
    values = models.triangle_splatting()
    values["sigma"][0] = np.nan
    bad = write_model(tmp_path, "triangle_splatting", values)
    result = here("validate", "--json", "-", bad)
    assert result.status == 1
    assert [item["code"] for item in result.json["findings"]] == ["CHECKPOINT_NONFINITE"]


def test_codes_are_explained_by_name_or_all(here: Here) -> None:
    explained = here("validate", "--explain", "triasset_damaged", "--json", "-").json
    assert (explained["code"], explained["exit_status"]) == ("TRIASSET_DAMAGED", 3)
    wrong = here("validate", "--explain", "TRIASSET_DAMAGE")
    assert (wrong.status, wrong.err.split(":")[0]) == (2, "NAME_UNKNOWN")
    assert "TRIASSET_DAMAGED" in wrong.err
    every = here("validate", "--explain", "all", "--json", "-").json
    assert [item["code"] for item in every] == list(explained_codes())


def test_stopping_at_the_first_failure(here: Here, tmp_path: Path, demo_asset: Path) -> None:
    (tmp_path / "bad.ply").write_text("no mesh")
    for line, lines in (("audit bad.ply", 0), ("validate none.ply", 0), ("validate bad.ply", 1)):
        command, bad = line.split()
        result = here(command, "--fail-fast", "--jsonl", "-", tmp_path / bad, demo_asset)
        assert (result.status, len(result.out.splitlines())) == (1 if lines else 3, lines)
    result = here("validate", "--jsonl", "-", tmp_path / "none.ply", demo_asset)
    assert [("error" in json.loads(line)) for line in result.out.splitlines()] == [True, False]
