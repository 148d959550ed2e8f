"""The recipes for training with official code; only their dry runs, because training needs a GPU."""

import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from msb.registry import METHODS
from tests.conftest import ROOT

FOLDER = ROOT / "benchmarks" / "recipes"
RECIPES = sorted(path for path in FOLDER.glob("*.sh") if path.stem != "common")
SIZES = {"garden": "images_4", "room": "images_2", "truck": "images"}

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")


def dry(recipe: Path, scene: Path, out: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([recipe, "--dry-run", scene, out], capture_output=True, text=True, check=False)


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """Return a folder, with a blank in its name, that has the folders and files of three scenes."""
    for name, folder in SIZES.items():
        scene = tmp_path / "my data" / name
        for images in {folder, "images_4" if folder != "images" else folder}:
            (scene / images).mkdir(parents=True)
        (scene / "sparse" / "0").mkdir(parents=True)
        (scene / "sparse" / "0" / "point_cloud.ply").touch()
    return tmp_path / "my data"


def test_each_method_of_the_paper_has_a_recipe() -> None:
    assert {path.stem for path in RECIPES} == {
        name for name, method in METHODS.items() if method.paper_name and "dedicated" in method.retained
    }


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.stem)
def test_a_dry_run_prints_all_steps(recipe: Path, scenes: Path, tmp_path: Path) -> None:
    tables = pytest.importorskip("msb.bench.protocol_tables", reason="msb.bench was removed")
    for name in SIZES:
        shown = dry(recipe, scenes / name, tmp_path / "out")
        assert shown.returncode == 0, shown.stderr
        assert shown.stdout.startswith("NOT TRIED: ")
        steps = [line for line in shown.stdout.splitlines() if line.startswith("+ ")]
        assert any(" git clone --recursive https://github.com/" in step for step in steps)
        assert sum(" msb track -o " in step and "python" in step for step in steps) == 1
        assert f"my\\ data/{name}" in shown.stdout or f"my\\ data {name} " in shown.stdout
        (table,) = tomllib.loads(shown.stdout.partition("# for a protocol of msb run:")[2])["methods"]
        assert tables.MethodTable.model_validate(table).name == recipe.stem
    assert not (tmp_path / "out").exists()


def test_unsuitable_scenes_are_rejected(scenes: Path, tmp_path: Path) -> None:
    recipe = FOLDER / "two_dts.sh"
    assert subprocess.run([recipe], capture_output=True, check=False).returncode == 2
    (scenes / "garden" / "sparse" / "0" / "point_cloud.ply").unlink()  # 2DTS needs a dense point cloud
    (scenes / "room" / "images_4").rmdir()
    diffsoup = FOLDER / "diffsoup.sh"
    for script, scene, word in (
        (recipe, tmp_path / "nowhere", "COLMAP"),
        (recipe, scenes / "garden", "point cloud"),
        (diffsoup, scenes / "room", "images_4"),
    ):
        rejected = dry(script, scene, tmp_path / "out")
        assert (rejected.returncode, rejected.stdout) == (3, "")
        assert word in rejected.stderr
    (scenes / "garden").rename(scenes / "desk")
    assert "desk" in dry(recipe, scenes / "desk", tmp_path / "out").stderr
