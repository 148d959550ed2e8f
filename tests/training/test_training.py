"""A training improves the model and can be resumed, and `msb` renders the model like the trainer."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from data_stubs.training import loop
from data_stubs.training.loop import Length, Training
from data_stubs.training.methods import MODELS
from data_stubs.training.model import Options
from data_stubs.training.scene import read_capture
from data_stubs.training.state import FILE, read_state, write_state
from msb import metrics
from msb.errors import UsageError
from msb.reference import render_reference
from tests.conftest import ROOT

SCENES = ROOT / "tests" / "tiny" / "scenes"
COLMAP = SCENES / "mipnerf360" / "pebble"
METHODS = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup", "three_dgs", "two_dgs")


def training(folder: Path, method: str, scene: Path = COLMAP, iterations: int = 12) -> Any:
    capture = read_capture(scene, method, None, None, 0)
    model = MODELS[method](capture, Options(faces=300, sh_degree=1, seed=0))
    return Training(model, Length(1, iterations), folder, {})


def values(run: Any) -> dict[str, np.ndarray]:
    return {name: parameter.detach().numpy().copy() for name, parameter in run.model.parameters.items()}


@pytest.mark.parametrize(
    ("method", "scene", "iterations"),
    [*((method, COLMAP, 150) for method in METHODS), ("two_dts", SCENES / "nerf_synthetic" / "pebble", 12)],
)
def test_training_improves_psnr_and_msb_measures_the_same(
    method: str, scene: Path, iterations: int, tmp_path: Path
) -> None:
    run = training(tmp_path, method, scene, iterations)
    before = np.mean(run.held_out(run.model.settings(1.0)))
    run.run(lambda: False)
    assert iterations < 100 or run.log[-1]["psnr"] > before + 1
    assert run.model.faces <= 300
    asset = msb.export(tmp_path)
    psnr = [
        metrics.psnr(
            np.clip(render_reference(asset, camera, run.model.capture.background).image, 0, 1), image
        )
        for camera, image in run.model.capture.test
    ]
    assert asset.manifest.method == method
    assert run.log[-1]["psnr"] == pytest.approx(np.mean(psnr), abs=0.01)
    assert asset.manifest.face_count == run.model.faces


@pytest.mark.parametrize("method", METHODS)
def test_a_resumed_training_gives_the_same_model(method: str, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "EVERY", 14)  # changes the mesh before and after the interruption
        whole = training(tmp_path / "whole", method, iterations=32)
        whole.run(lambda: False)
        part = training(tmp_path / "part", method, iterations=32)
        part.run(lambda: part.iteration == 20)
        rest = training(tmp_path / "part", method, iterations=32)
        rest.resume()
        rest.run(lambda: False)
    assert rest.iteration == 32
    assert have_equal_parameters(whole, rest)


def have_equal_parameters(first: Any, other: Any) -> bool:
    pairs = zip(values(first).values(), values(other).values(), strict=True)
    return all(a.shape == b.shape and (a == b).all() for a, b in pairs)


def test_another_training_is_not_resumed(tmp_path: Path) -> None:
    run = training(tmp_path, "two_dts")
    with pytest.raises(UsageError, match="not the state of a training"):
        run.resume()
    run.save()
    with pytest.raises(UsageError, match="method"):
        training(tmp_path, "triangle_splatting").resume()
    arrays, about = read_state(tmp_path / FILE)
    assert all(array.dtype.kind in "fiu" for array in arrays.values())
    write_state(
        tmp_path / FILE, {name: array for name, array in arrays.items() if name != "seen/peak"}, about
    )
    with pytest.raises(UsageError, match="seen/peak"):
        training(tmp_path, "two_dts").resume()


def test_command(tmp_path: Path) -> None:
    scene = ["--scene", str(COLMAP)]
    options = ["--method", "triangle_splatting", "--faces", "200", "--iterations", "5"]
    line = [
        sys.executable,
        "-m",
        "data_stubs.training",
        *options,
        *scene,
        "--output",
        str(tmp_path / "model"),
    ]
    done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    log = json.loads((tmp_path / "model" / "training.json").read_text())
    assert log["iterations"] == 5
