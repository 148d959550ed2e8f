"""Recipes of official trainings: their dry runs, because training needs a GPU, and their timings."""

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb.registry import METHODS
from tests.conftest import ROOT

FOLDER = ROOT / "benchmarks" / "recipes"
RECIPES = sorted(path for path in FOLDER.glob("*.sh") if path.stem != "common")
SCENES = {
    "garden": ("mipnerf360", "images_4"),
    "room": ("mipnerf360", "images_2"),
    "truck": ("tanksandtemples", "images"),
    "chair": ("nerf_synthetic", "test"),
    "scan24": ("dtu", "images"),
}

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")


def dry(recipe: Path, *arguments: Path) -> subprocess.CompletedProcess[str]:
    command = [recipe, "--dry-run", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """Return a folder, with a blank in its name, that has the folders and files of five scenes."""
    for name, (dataset, folder) in SCENES.items():
        scene = tmp_path / "my data" / name
        for images in {folder, "images_4" if dataset == "mipnerf360" else folder}:
            (scene / images).mkdir(parents=True)
        (scene / "sparse" / "0").mkdir(parents=True)
        (scene / "transforms_train.json").touch()
    return tmp_path / "my data"


def paths_of_paper(recipe: Path, name: str, root: Path) -> Mapping[str, Path]:
    """Return key of a method in the paper's protocol -> its path for a scene."""
    protocol = pytest.importorskip("msb.bench.protocol", reason="msb.bench was removed")
    file = protocol.parse_protocol(protocol.read_example("paper"), root / "paper.toml")
    dataset = SCENES[name][0]
    (table,) = [
        method
        for method in file.protocol.methods
        if method.name == recipe.stem and (not method.datasets or dataset in method.datasets)
    ]
    names = {"dataset": dataset, "scene": name, "method": recipe.stem}
    keys = ("model", "non_engine", "non_engine_timing", "training")
    return {key: file.resolve(getattr(table, key), **names) for key in keys if getattr(table, key)}


def test_each_method_of_the_paper_has_a_recipe() -> None:
    assert {path.stem for path in RECIPES} == {name for name, method in METHODS.items() if method.paper_name}


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.stem)
@pytest.mark.slow
def test_a_dry_run_prints_all_steps_with_the_paths_of_the_papers_protocol(
    recipe: Path, scenes: Path, tmp_path: Path
) -> None:
    root = tmp_path / "out"
    methods_of_few_datasets = ("two_dgs", "three_dgs")
    for name in SCENES if recipe.stem not in methods_of_few_datasets else ("garden", "room"):
        shown = dry(recipe, scenes / name, root)
        assert shown.returncode == 0, shown.stderr
        steps = [line for line in shown.stdout.splitlines() if line.startswith("+ ")]
        assert any(" git clone --recursive https://github.com/" in step for step in steps)
        # Each file that the protocol names is written by a step: training record, timing, model, renderings.
        paths = paths_of_paper(recipe, name, root)
        (training,) = [step for step in steps if f"-o {root}/training/{recipe.stem}/" in step]
        assert " msb track " in training
        if "training" in paths:  # 3DGS has no column for its training
            assert f"-o {paths['training']} " in training
        (evaluation,) = [step for step in steps if f"official.py {recipe.stem} " in step]
        assert f" {paths['non_engine_timing']} " in evaluation
        assert paths["non_engine"].is_relative_to(root / "output") or f" {paths['non_engine']}" in evaluation
        model = paths.get("model")
        assert model is None or any(str(model) in step.split() for step in steps)
    assert not root.exists()


def test_finished_steps_are_not_repeated(scenes: Path, tmp_path: Path) -> None:
    recipe, root = FOLDER / "triangle_splatting.sh", tmp_path / "out"
    model = root / "output" / recipe.stem / "mipnerf360" / "garden"
    for mark in (
        root / "code" / f".{recipe.stem}",
        root / "env" / recipe.stem / ".ready",
        model / ".trained",
    ):
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
    steps = [line for line in dry(recipe, scenes / "garden", root).stdout.splitlines() if line[:2] == "+ "]
    assert not any(word in step for step in steps for word in ("git clone", "conda env", "train.py"))
    assert any("official.py" in step for step in steps)
    again = dry(recipe, scenes / "room", root).stdout  # another scene uses code and environment
    assert "train.py" in again
    assert "git clone" not in again


def test_the_cloud_of_2dts_is_that_of_3dgs_unless_the_scene_has_one(scenes: Path, tmp_path: Path) -> None:
    recipe, link = FOLDER / "two_dts.sh", "iteration_30000/point_cloud.ply"
    shown = dry(recipe, scenes / "garden", tmp_path / "out").stdout
    assert shown.index("official.py three_dgs") < shown.index(link) < shown.index("official.py two_dts")
    (scenes / "garden" / "sparse" / "0" / "point_cloud.ply").touch()
    assert "three_dgs" not in dry(recipe, scenes / "garden", tmp_path / "out").stdout


def test_unsuitable_scenes_are_rejected(scenes: Path, tmp_path: Path) -> None:
    recipe = FOLDER / "two_dts.sh"
    assert subprocess.run([recipe], capture_output=True, check=False).returncode == 2
    (scenes / "room" / "images_4").rmdir()
    (scenes / "chair" / "transforms_train.json").unlink()
    (scenes / "truck").rename(scenes / "desk")
    for script, scene, word in (
        (recipe, tmp_path / "nowhere", "nowhere"),
        (recipe, scenes / "chair", "transforms_train.json"),
        (recipe, scenes / "desk", "desk"),
        (FOLDER / "diffsoup.sh", scenes / "room", "images_4"),
    ):
        rejected = dry(script, scene, tmp_path / "out")
        assert (rejected.returncode, rejected.stdout) == (3, "")
        assert word in rejected.stderr


STAND_INS = {
    "torch/__init__.py": """
import contextlib
from . import cuda
no_grad, Tensor = contextlib.nullcontext, object
""",
    "torch/cuda.py": """
def synchronize(): pass
def get_device_name(number): return "Made-up GPU"
def max_memory_allocated(number): return 1 << 30
""",
    "triangle_renderer.py": "calls = []\ndef render(view): calls.append(view)\n",
    "render.py": """
import sys
from triangle_renderer import calls, render
for view in sys.argv[1:]: render(view)
open("calls", "w").write(" ".join(calls))
""",
    "src/diff_recon.py": """
from types import SimpleNamespace as Names
import numpy as np
class Pixels:
    def __init__(self, array): self.array = array
    def permute(self, *axes): return Pixels(self.array.transpose(axes))
    def clamp(self, low, high): return Pixels(self.array.clip(low, high))
    def cpu(self): return self
    def numpy(self): return self.array
def loadConfig(path): return Names(dataset=Names())
class Model:
    def load_ckpt(self, path): assert path.endswith("/ckpt/20.ckpt")
    def forward(self, camera, background): return {"render": Pixels(np.full((3, 2, 4), camera / 2))}
class VanillaTSTrainer:
    def __init__(self, config, exp_name, device, log_file):
        assert (config.dataset.scene_id, config.dataset.test_target_res, log_file) == ("garden", 4, False)
        self.model = Model()
    def evaluate(self):
        for camera in range(3): self.model.forward(camera, "white")
""",
}  # fmt: skip


def run_official(folder: Path, *arguments: str) -> Any:
    """Run official.py beside stand-ins for PyTorch and official code, and return its timing."""
    for name, text in STAND_INS.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    method, *rest = arguments
    command = [sys.executable, FOLDER / "official.py", method, "timing.json", *rest]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env={"PYTHONPATH": "."}, check=False
    )
    assert done.returncode == 0, done.stderr
    records = pytest.importorskip("msb.bench.records", reason="msb.bench was removed")
    return records.read_renderer_timing(folder / "timing.json")


def test_the_official_renderer_is_timed_while_its_script_draws(tmp_path: Path) -> None:
    timing = run_official(tmp_path, "mesh_splatting", "render.py", "a", "b")
    calls = (tmp_path / "calls").read_text().split()
    assert (calls.count("a"), calls.count("b")) == (21, 11)  # one to draw, ten to warm up, ten each to time
    assert (timing.frames, timing.device, timing.whole_command) == (20, "Made-up GPU", False)
    assert json.loads((tmp_path / "timing.json").read_text())["peak_gpu_memory_bytes"] == 1 << 30


def test_the_test_views_of_2dts_are_written(tmp_path: Path) -> None:
    for step in (3, 20):
        (tmp_path / "model" / "ckpt").mkdir(parents=True, exist_ok=True)
        (tmp_path / "model" / "ckpt" / f"{step}.ckpt").touch()
    timing = run_official(tmp_path, "two_dts", "c.yaml", "data/garden", "4", "model", "renders/x")
    assert timing.frames == 30
    images = sorted((tmp_path / "renders" / "x").iterdir())
    assert [path.name for path in images] == ["00000.png", "00001.png", "00002.png"]
    assert [np.asarray(Image.open(path)).shape for path in images] == [(2, 4, 3)] * 3
    assert int(np.asarray(Image.open(images[1])).max()) == 127  # truncated, not rounded
