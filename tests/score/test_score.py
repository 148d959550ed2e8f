"""Scores with a given pose: pictures, flags, comparison, gates, certificate and the command."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import msb
from data_stubs.surface import pebble
from msb.errors import MsbError, UsageError
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.metrics.ground_truth import ground_truth
from msb.metrics.images import psnr
from msb.scenes.datasets import Scene
from msb.score import Score, compare_scores
from msb.score import score as measure
from msb.score.capture import Capture, Protocol
from msb.score.measurement import read_matrix
from msb.score.options import KEYS, parse_condition
from tests.cli.conftest import Here, here
from tests.conftest import ROOT
from tests.score import tricks

__all__ = ["here"]  # fixture
pytest.importorskip("cv2")
SCENES = ROOT / "tests" / "tiny" / "scenes"
CAPTURE = SCENES / "nerf_synthetic" / "pebble"
SURFACE = pebble()
COLORS = (np.clip(SURFACE.color, 0, 1) * 255 + 0.5).astype(np.uint8)
MESH = Mesh(SURFACE.vertices, SURFACE.faces, COLORS)


@pytest.fixture(scope="module")
def capture() -> Capture:
    return Capture(CAPTURE)


def saved(mesh: Mesh, folder: Path, name: str = "asset.ply") -> Path:
    path = folder / name
    msb.save(asset_from_mesh(mesh), path)
    return path


def test_pictures_are_those_of_the_standard_tier(tmp_path: Path) -> None:
    path = saved(MESH, tmp_path)
    scene = Capture(CAPTURE, Protocol(1, (0.0, 0.0, 0.0))).scene
    result = measure(path, CAPTURE, pose="capture", protocol=Protocol(1, (0.0, 0.0, 0.0)))
    asset = msb.open(path)
    expected = [
        psnr(
            msb.render(asset, camera, tier="standard", background=(0, 0, 0)).image,
            ground_truth(scene, camera),
        )
        for camera in scene.test
    ]
    assert result.looks is not None
    assert result.looks["psnr"] == pytest.approx(np.mean(expected), abs=1e-9)


def test_a_good_asset_has_numbers_and_no_flags(capture: Capture, tmp_path: Path) -> None:
    result = measure(saved(MESH, tmp_path), capture, pose="capture")
    assert (result.status, result.why, result.flags) == ("scored", None, [])
    looks = result.looks
    assert looks is not None
    assert 24 < looks["psnr_covered"] < looks["psnr"]  # type: ignore[operator]
    assert looks["psnr_exposure"] >= looks["psnr"]  # type: ignore[operator]
    assert abs(looks["psnr_mask"] - looks["psnr_covered"]) < 1  # type: ignore[operator]
    assert result.mask_share == pytest.approx(1, abs=0.02)
    background = capture.test[0].photograph[0, 0]
    assert np.allclose(background, 0.5, atol=1 / 255)


def test_equal_assets_do_not_differ(capture: Capture, tmp_path: Path) -> None:
    first = measure(saved(MESH, tmp_path), capture, pose="capture")
    second = measure(saved(MESH, tmp_path, "asset.glb"), capture, pose="capture")
    differences = compare_scores(first, second).differences
    assert set(differences) == {"psnr", "ssim", "psnr_both"}
    for entry in differences.values():
        assert abs(entry["mean"]) < 0.05
        assert entry["interval"][0] <= entry["mean"] <= entry["interval"][1]
    black = measure(saved(BLACK, tmp_path, "black.ply"), capture, pose="capture")
    assert compare_scores(first, black).differences["psnr"]["interval"][1] < 0
    assert first.hashes["capture"] == second.hashes["capture"]
    assert first.hashes["asset"] != second.hashes["asset"]


INSIDE_OUT = replace(MESH, faces=MESH.faces[:, ::-1].copy())
SMALL = replace(MESH, faces=MESH.faces[:3])
BLACK = replace(MESH, vertex_colors=np.zeros_like(COLORS))
Trick = Callable[[Scene], Mesh]
TRICKS: dict[str, Trick] = {
    "NO_CONTRAST": lambda _: BLACK,
    "INSIDE_OUT": lambda _: INSIDE_OUT,
    "LOW_COVERAGE": lambda _: SMALL,
    "EXTREME_SCALE": lambda _: replace(MESH, vertices=MESH.vertices * 1e6),
    "SINGLE_VIEW_FACES": tricks.billboards,
}


@pytest.mark.parametrize("code", TRICKS)
def test_a_trick_is_named_in_the_verdict(code: str, capture: Capture, tmp_path: Path) -> None:
    mesh = TRICKS[code](capture.scene)
    name = "asset.obj" if mesh.textures else "asset.ply"
    result = measure(saved(mesh, tmp_path, name), capture, pose="capture")
    assert code in {flag.code for flag in result.flags}
    assert code in result.verdict


def test_invalid_values_are_left_out_and_named(capture: Capture, tmp_path: Path) -> None:
    path = tmp_path / "asset.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in MESH.vertices.tolist()]
    lines[0] = "v nan 0 0"
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (MESH.faces + 1).tolist())]) + "\n")
    result = measure(path, capture, pose="capture")
    assert "INVALID_VALUES" in {flag.code for flag in result.flags}


def test_a_mirrored_pose_of_a_file_is_named(capture: Capture, tmp_path: Path) -> None:
    matrix = np.diag([1.0, -1, 1, 1])
    file = tmp_path / "pose.json"
    file.write_text(json.dumps({"pose": {"matrix": matrix.tolist()}}))
    straight = measure(saved(MESH, tmp_path), capture, pose="capture")
    mirrored = replace(MESH, vertices=MESH.vertices * (1, -1, 1), faces=MESH.faces[:, ::-1].copy())
    result = measure(saved(mirrored, tmp_path, "mirrored.ply"), capture, pose=file)
    assert {flag.code for flag in result.flags} == {"MIRRORED"}
    assert result.looks is not None
    assert straight.looks is not None
    assert result.looks["psnr"] == pytest.approx(straight.looks["psnr"], abs=0.02)


@pytest.mark.parametrize(
    "value",
    [[1, 2], {"matrix": "x"}, np.zeros((4, 4)).tolist(), np.diag([1.0, 2, 1, 1]).tolist(), {"pose": None}],
)
def test_an_invalid_matrix_is_rejected(value: object, tmp_path: Path) -> None:
    file = tmp_path / "pose.json"
    file.write_text(json.dumps(value))
    with pytest.raises(MsbError) as caught:
        read_matrix(file)
    assert caught.value.code == "CAMERA_INVALID"


def test_photographs_without_features_leave_an_asset_unverified(capture: Capture, tmp_path: Path) -> None:
    """The photographs of the tiny scenes are too smooth for features."""
    result = measure(saved(MESH, tmp_path), capture)
    assert (result.status, result.looks, result.pose, result.flags) == ("unverified", None, None, [])
    assert result.why
    assert result.verdict.startswith("UNVERIFIED")


def test_the_texel_density_of_a_card(capture: Capture, tmp_path: Path) -> None:
    camera = capture.scene.train[0]
    path = saved(tricks.card(capture.scene, camera, 2.0), tmp_path, "asset.obj")
    structure = measure(path, capture, pose="capture").structure
    assert structure.textures == [[camera.width, camera.height]]
    assert structure.texel_density == pytest.approx(camera.fx / 2, rel=1e-4)


@pytest.mark.slow
def test_a_trial_is_in_the_document(here: Here, tmp_path: Path) -> None:
    pytest.importorskip("msb.trial")
    words = ("score", "--pose", "capture", "--capture", CAPTURE, saved(MESH, tmp_path), "--json", "-")
    (entry,) = here(*words, "--trial", "subdivide").json["trial"]
    assert (entry["task"], entry["outcome"]) == ("subdivide", "works")
    assert here(*words, "--trial", "dance").status == 2


def test_conditions() -> None:
    document: dict[str, Any] = {
        "path": "a",
        "looks": {"psnr": 20.0, "lpips": None},
        "flags": [{}],
        "pose": None,
    }
    assert parse_condition("psnr<24").check(document) is not None
    assert parse_condition("psnr < 19").check(document) is None
    assert parse_condition("lpips>1").check(document) is not None  # it is not measured
    assert parse_condition("flags>0").check(document) is not None
    assert parse_condition("residual>1").check(document) is not None
    for text in ("psnr", "colour<2", "psnr<nan", "psnr=2"):
        with pytest.raises(UsageError):
            parse_condition(text)


def test_the_command_writes_documents_and_a_certificate(here: Here, tmp_path: Path) -> None:
    path, folder = saved(MESH, tmp_path), tmp_path / "certificate"
    words = ["score", "--pose", "capture", "--walk", "4", "--capture", CAPTURE, "-o", folder, "--json", "-"]
    result = here(*words, path, saved(BLACK, tmp_path, "black.ply"), "--fail-on", "psnr<24")
    first, second = result.json
    assert result.status == 1
    assert "GATE_FAILED" in result.err
    assert first["schema"] == "msb.score/1"
    keys = {"path", "capture", "status", "why", "pose", "views", "looks", "structure", "flags", "seconds"}
    assert keys <= set(first)
    assert set(first["hashes"]) == {"asset", "capture", "protocol"}
    assert {"verdict", "sentence", "faces", "bytes", "textures"} < set(first["structure"])
    assert first["views"]["test"] == 4
    assert first["walk"]["shimmer"] >= 0
    assert second["compared"]["differences"]["psnr"]["mean"] < 0
    for where in KEYS.values():  # every key of --fail-on is in the document
        value = first
        for key in where:
            value = value[key]
    page = (folder / "index.html").read_text()
    assert page.count("data:image/jpeg") == 4 * 3 * 2 + 4
    assert "http" not in page.replace('http-equiv="Content-Security-Policy"', "")
    assert "NO_CONTRAST" in page
    assert json.loads((folder / "score.json").read_text())[0]["hashes"] == first["hashes"]


def test_an_unverified_asset_ends_with_status_1(here: Here, tmp_path: Path) -> None:
    result = here("score", "--capture", CAPTURE, saved(MESH, tmp_path), "--json", "-")
    assert (result.status, result.json["status"], result.json["looks"]) == (1, "unverified", None)


def test_wrong_usage(here: Here, tmp_path: Path) -> None:
    path = saved(MESH, tmp_path)
    assert here("score", path).status == 2
    assert here("score", path, "--capture", CAPTURE, "--walk", "2").status == 2
    assert here("score", path, "--capture", CAPTURE, "--fail-on", "beauty<1").status == 2
    assert here("score", path, "--capture", tmp_path / "none").status == 3
    assert here("score", path, "--capture", CAPTURE, "--pose", tmp_path / "none.json").status == 3


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="the steps of the action need bash")
def test_the_action_has_the_exit_status_of_the_score(tmp_path: Path) -> None:
    steps = yaml.safe_load((ROOT / "action.yml").read_text())["runs"]["steps"]
    (step,) = (step for step in steps if step.get("id") == "score")
    variables = {"PATHS": str(saved(MESH, tmp_path)), "CAPTURE": str(CAPTURE), "FAIL_ON": "faces>1\nflags>0"}
    for name in ("RUNNER_TEMP", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        variables[name] = str(tmp_path if name == "RUNNER_TEMP" else tmp_path / name)
    variables["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", step["run"]]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **variables}, check=False)
    assert done.returncode == 1  # the smooth photographs leave the asset unverified
    path = (tmp_path / "GITHUB_OUTPUT").read_text().strip().removeprefix("json=")
    assert json.loads(Path(path).read_text())["status"] == "unverified"
    assert "UNVERIFIED" in (tmp_path / "GITHUB_STEP_SUMMARY").read_text()


def test_the_function_of_the_package(tmp_path: Path) -> None:
    result = msb.score(saved(MESH, tmp_path), capture=CAPTURE, pose="capture")
    assert isinstance(result, Score)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["status"] == "scored"
