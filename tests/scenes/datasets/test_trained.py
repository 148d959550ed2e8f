"""Warnings about a training or recording that differs from the evaluation: split, background, size."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from msb.scenes import read_cameras
from msb.scenes.datasets import compare_training, note_recorded_size, note_scaled_cameras, read_scene

from .conftest import STUBS

CAPTURE = STUBS / "mipnerf360/pebble"
"""Photographs have 64 x 48 pixels in images_4 (evaluated), 128 x 96 in images_2, and 256 x 192 in images."""
ALIKE: list[dict[str, Any]] = [
    {},
    {"eval": True, "images": "images_4", "resolution": -1},
    {"images": "images", "resolution": 4},
    {"width": 64, "height": 48},
    {"images": "somewhere", "resolution": 1},  # the size of that folder is unknown
]


@pytest.mark.parametrize("training", ALIKE, ids=str)
def test_equal_training_and_evaluation_give_no_warning(training: dict[str, Any]) -> None:
    scene = read_scene(CAPTURE)
    for background in (None, (0.0, 0.0, 0.0)):
        assert list(compare_training(training, background, scene)) == []


@pytest.mark.parametrize(
    ("training", "size"),
    [
        ({"images": "images_2", "resolution": -1}, "128 x 96"),
        ({"images": "images_4", "resolution": 2}, "32 x 24"),
        ({"images": "images_8", "resolution": 1}, "32 x 24"),  # that folder no longer exists
        ({"images": "images", "resolution": 100}, "100 x 75"),
        ({"width": 640, "height": 480}, "640 x 480"),
    ],
    ids=str,
)
def test_a_different_size_is_reported_with_both_sizes(training: dict[str, Any], size: str) -> None:
    (warning,) = compare_training(training, None, read_scene(CAPTURE))
    assert f"{size} pixels" in warning.message
    assert "64 x 48" in warning.message


def test_split_and_background_are_reported() -> None:
    first, second = compare_training({"eval": False}, (1.0, 1.0, 1.0), read_scene(CAPTURE))
    assert "eval=False" in first.message
    assert "over white" in second.message


PEBBLE = STUBS / "mipnerf360/pebble"


def test_scaled_cameras_are_noted_with_all_sizes() -> None:
    names = ("dtu/scan1", "mipnerf360/pebble", "tanksandtemples/pebble")
    masked, small, other = (read_scene(STUBS / name) for name in names)
    note = note_scaled_cameras([masked, small, small])
    assert all(text in note for text in ("pebble", "256 x 192", "images_4", "64 x 48"))
    more = note_scaled_cameras([masked, small, other])
    assert more.startswith(note)
    assert more != note
    assert note_scaled_cameras([masked]) is None  # photographs have the recorded size; a rule resizes them
    halved = read_scene(PEBBLE, image_folder="images_2", dataset="custom", resolution=2)
    assert "images_2 have 128 x 96" in note_scaled_cameras([halved])


def test_the_note_on_recorded_size_names_the_scale_of_the_photographs(tmp_path: Path) -> None:
    assert note_recorded_size(PEBBLE, read_cameras(PEBBLE)) is None  # images has their size
    for name in ("sparse", "images_2", "images_4"):
        shutil.copytree(PEBBLE / name, tmp_path / name)
    for place in (tmp_path, tmp_path / "sparse/0"):
        note = note_recorded_size(place, read_cameras(place))
        assert all(text in note for text in ("256 x 192", "128 x 96", "--scale 0.5"))
    shutil.rmtree(tmp_path / "images_2")
    shutil.rmtree(tmp_path / "images_4")
    assert note_recorded_size(tmp_path, read_cameras(tmp_path)) is None
