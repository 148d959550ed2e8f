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
    assert note == (
        "the cameras of pebble were recorded at 256 x 192 pixels, the photographs in images_4 have 64 x 48: "
        "the cameras are scaled, 64 x 48 is drawn and compared"
    )
    assert scaled_note([masked, small, other]) == f"{note}; so it is in 1 more scene"
    assert scaled_note([masked]) is None  # photographs of the recorded size: what resizes them is a rule
    halved = read_scene(PEBBLE, image_folder="images_2", dataset="custom", resolution=2)
    text = scaled_note([halved])
    assert "photographs in images_2 have 128 x 96: the cameras are scaled, 64 x 48 is drawn" in text


def test_cameras_as_recorded_name_the_scale_of_the_photographs_beside_them(tmp_path: Path) -> None:
    assert recorded_note(PEBBLE, read_cameras(PEBBLE)) is None  # images has their size
    for name in ("sparse", "images_2", "images_4"):
        shutil.copytree(PEBBLE / name, tmp_path / name)
    for place in (tmp_path, tmp_path / "sparse/0"):
        note = recorded_note(place, read_cameras(place))
        assert "drawn as recorded, at 256 x 192 pixels" in note
        assert "images_2 have 128 x 96: --scale 0.5 draws at their size" in note
    shutil.rmtree(tmp_path / "images_2")
    shutil.rmtree(tmp_path / "images_4")
    assert recorded_note(tmp_path, read_cameras(tmp_path)) is None
