"""What is said of cameras that were recorded for larger images than the photographs that are there."""

from __future__ import annotations

import shutil
from pathlib import Path

from msb.scenes import read_cameras
from msb.scenes.datasets import read_scene, recorded_note, scaled_note

from .conftest import STUBS

PEBBLE = STUBS / "mipnerf360/pebble"


def test_scaled_cameras_are_noted_once_with_all_sizes() -> None:
    names = ("dtu/scan1", "mipnerf360/pebble", "tanksandtemples/pebble")
    masked, small, other = (read_scene(STUBS / name) for name in names)
    note = scaled_note([masked, small, small])
    assert all(text in note for text in ("pebble", "256 x 192", "images_4", "64 x 48"))
    more = scaled_note([masked, small, other])
    assert more.startswith(note)
    assert more != note
    assert scaled_note([masked]) is None  # photographs of the recorded size: what resizes them is a rule
    halved = read_scene(PEBBLE, image_folder="images_2", dataset="custom", resolution=2)
    assert "images_2 have 128 x 96" in scaled_note([halved])


def test_cameras_as_recorded_name_the_scale_of_the_photographs_beside_them(tmp_path: Path) -> None:
    assert recorded_note(PEBBLE, read_cameras(PEBBLE)) is None  # images has their size
    for name in ("sparse", "images_2", "images_4"):
        shutil.copytree(PEBBLE / name, tmp_path / name)
    for place in (tmp_path, tmp_path / "sparse/0"):
        note = recorded_note(place, read_cameras(place))
        assert all(text in note for text in ("256 x 192", "128 x 96", "--scale 0.5"))
    shutil.rmtree(tmp_path / "images_2")
    shutil.rmtree(tmp_path / "images_4")
    assert recorded_note(tmp_path, read_cameras(tmp_path)) is None
