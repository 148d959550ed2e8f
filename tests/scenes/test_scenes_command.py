"""`msb scenes`: output for valid and invalid scenes."""

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import Msb, msb
from tests.conftest import ROOT

__all__ = ["msb"]  # fixture
STUBS = ROOT / "tests" / "tiny" / "scenes"


@pytest.mark.slow
def test_several_scenes_are_a_table(msb: Msb) -> None:
    result = msb("scenes", STUBS, COLUMNS="80", status=0)
    lines = [line.split() for line in result.out.splitlines()]
    assert lines[0] == ["Scene", "Dataset", "Train", "Test", "Size", "Photographs"]
    assert ["scan1", "dtu", "14", "2", "72", "x", "54", "RGBA", "PNG,", "resized"] in lines
    assert ["pebble", "tanksandtemples", "14", "2", "112", "x", "80", "images"] in lines
    assert len(lines) == 5
    assert max(map(len, result.out.splitlines())) <= 80
    assert result.err.count("SCENE_UNKNOWN") == 4
    assert msb("scenes", "--quiet", STUBS).err == ""


@pytest.mark.slow
def test_one_scene_is_described_in_full(msb: Msb) -> None:
    result = msb("scenes", STUBS / "nerf_synthetic", COLUMNS="200", status=0)
    for text in ("12 training, 4 test", "72 x 72", "1 pinhole camera", "144 x 144"):
        assert text in result.out
    both = msb("scenes", "-v", STUBS / "dtu", STUBS / "mipnerf360", COLUMNS="200").out
    for text in ("SfM points", "no rule for dtu", "128 x 96"):
        assert text in both


def test_json_contains_the_scene(msb: Msb) -> None:
    data = msb("scenes", "--json", "-", "--rules", "two_dts", STUBS / "mipnerf360/pebble").json
    assert data["schema"] == "msb.scenes/1"
    (scene,) = data["scenes"]
    assert (scene["dataset"], scene["scene"], scene["layout"]) == ("mipnerf360", "pebble", "colmap")
    assert (scene["error"], scene["points"]) == (None, 400)
    evaluated = scene["evaluated"]
    assert evaluated["image_folder"] == "images"
    assert (evaluated["width"], evaluated["height"], evaluated["gt_resized"]) == (64, 48, True)
    assert evaluated["test"] == ["DSC07950.JPG", "DSC07958.JPG"]
    assert evaluated["background"] == [1, 1, 1]
    folders = {folder["name"]: (folder["images"], folder["used"]) for folder in scene["image_folders"]}
    assert folders == {"images": (16, 16), "images_2": (16, 0), "images_4": (16, 0)}
    assert "two_dts" not in scene["deviations"]
    assert scene["deviations"]["triangle_splatting"]


def test_options_reach_the_reader(msb: Msb) -> None:
    args = ("--image-folder", "images_2", "-r", "2", "--dataset", "mine", "--json", "-")
    (scene,) = msb("scenes", *args, STUBS / "mipnerf360/pebble").json["scenes"]
    assert scene["dataset"] == "mine"
    assert (scene["evaluated"]["width"], scene["evaluated"]["image_folder"]) == (64, "images_2")


@pytest.mark.slow
def test_an_invalid_scene_is_one_line_and_others_are_described(msb: Msb, tmp_path: Path) -> None:
    shutil.copytree(STUBS, tmp_path / "scenes")
    (tmp_path / "scenes/mipnerf360/pebble/images_4/DSC07950.JPG").unlink()
    result = msb("scenes --json", tmp_path / "out.json", tmp_path / "scenes", tmp_path / "nowhere", status=3)
    errors = [line for line in result.err.splitlines() if not line.startswith(("warning: ", "note: "))]
    assert len(errors) == 2
    assert errors[0].startswith("FILE_NOT_FOUND: ")
    assert errors[1].endswith("DSC07950.JPG")
    assert "SCENE_IMAGE_MISSING" in result.out
    scenes = json.loads((tmp_path / "out.json").read_text())["scenes"]
    codes = [scene["error"] and scene["error"]["code"] for scene in scenes]
    assert codes == [None, "SCENE_IMAGE_MISSING", None, None]


@pytest.mark.slow
def test_a_real_capture(msb: Msb, shared: Path) -> None:
    garden = shared / "golden" / "garden"
    rejected = msb("scenes", garden, status=3)
    assert "images_8" in rejected.err
    result = msb("scenes", "--image-folder", "images_8", garden, status=0)
    assert "28 training, 4 test" in result.out
    assert "138,766" in result.out


def test_missing_photographs_of_training_and_test_views_are_counted_apart(msb: Msb, tmp_path: Path) -> None:
    root = tmp_path / "mipnerf360/pebble"
    shutil.copytree(STUBS / "mipnerf360/pebble", root)
    (whole,) = msb("scenes --json -", root).json["scenes"]
    assert whole["missing"] == {"training": 0, "test": 0}
    evaluated = whole["evaluated"]
    photographs = root / evaluated["image_folder"]
    for name in evaluated["train"][:3]:
        (photographs / name).unlink()
    (scene,) = msb("scenes --json -", root).json["scenes"]
    assert (scene["error"], scene["missing"]) == (None, {"training": 3, "test": 0})
    # A missing test photograph is an error; the message also counts missing training photographs.
    (photographs / evaluated["test"][0]).unlink()
    (scene,) = msb("scenes --json -", root, status=3).json["scenes"]
    assert (scene["error"]["code"], scene["missing"]) == ("SCENE_IMAGE_MISSING", {"training": 3, "test": 1})
    counts = f"1 of {len(evaluated['test'])} test and 3 of {len(evaluated['train'])} training"
    assert counts in scene["error"]["message"]
    # Without the folder, all photographs are missing.
    for folder in root.glob("images*"):
        shutil.rmtree(folder)
    (scene,) = msb("scenes --json -", root, status=3).json["scenes"]
    assert scene["missing"] == {"training": len(evaluated["train"]), "test": len(evaluated["test"])}
