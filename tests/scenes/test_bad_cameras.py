"""Files that are not valid: one error with the right code. How much memory they take, tests/fuzz sees."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import msb
from msb.errors import InputError, SceneError
from msb.scenes import read_points

from .bad_cameras import BAD, SMALL
from .builders import write


def reader(name: str) -> Callable[[Path], Any]:
    return read_points if name.startswith("points") else msb.read_cameras


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name: str, tmp_path: Path) -> None:
    files, target, code, message = BAD[name]
    write(tmp_path, files)
    with pytest.raises(SceneError) as caught:
        reader(name)(tmp_path / target)
    error = caught.value
    assert error.code == code
    assert message in error.message
    assert str(error.file).startswith(str(tmp_path))
    assert str(error) == f"{code}: {error.file}: {error.message}"
    assert str(error).isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None


NOT_OF_FILES = {"CAMERA_PATH"}


def test_every_code_has_a_bad_file() -> None:
    # tests/scenes/datasets has those of datasets.
    cameras = {code for code in SceneError.codes if not code.startswith("SCENE_")}
    assert {bad[2] for bad in BAD.values()} == cameras - NOT_OF_FILES


def test_a_model_of_too_many_images(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write(tmp_path, SMALL["text"])
    monkeypatch.setattr("msb.scenes.colmap.MAX_CAMERAS", 1)
    with pytest.raises(SceneError, match=r"CAMERA_FILE: .*images.txt: line 5: there are more than 1 im"):
        msb.read_cameras(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="needs links and pipes")
def test_links_are_followed_but_pipes_are_not(tmp_path: Path) -> None:
    import os

    write(tmp_path / "real", SMALL["cameras.json"])
    (tmp_path / "linked").symlink_to(tmp_path / "real")
    assert len(msb.read_cameras(tmp_path / "linked" / "cameras.json")) == 1
    os.mkfifo(tmp_path / "cameras.json")
    with pytest.raises(InputError, match="FILE_UNREADABLE"):
        msb.read_cameras(tmp_path / "cameras.json")
    os.mkfifo(tmp_path / "images.bin")
    with pytest.raises(SceneError, match="CAMERA_SOURCE"):
        msb.read_cameras(tmp_path)
    write(tmp_path, {"transforms.json": SMALL["transforms.json"]["transforms.json"]})
    os.mkfifo(tmp_path / "a.jpg")
    with pytest.raises(SceneError, match="CAMERA_IMAGE"):
        msb.read_cameras(tmp_path)
