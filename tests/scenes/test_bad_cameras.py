"""Files that are not valid: one error with its code and words. How much memory they take, tests/fuzz sees."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import msb
from msb.errors import InputError, SceneError
from tests.corpus.refusals import kept, own_words

from .bad_cameras import BAD, SMALL, read_case
from .builders import write

WORDS = kept()


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name: str, tmp_path: Path) -> None:
    code = BAD[name][2]
    with pytest.raises(SceneError) as caught:
        read_case(name, tmp_path)
    error = caught.value
    assert error.code == code
    assert own_words(error.message) == WORDS[f"cameras/{name}"]
    assert str(error.file).startswith(str(tmp_path))
    assert str(error) == f"{code}: {error.file}: {error.message}"
    assert str(error).isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None


def test_the_byte_that_is_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="byte 2 is 0xff"):
        read_case("json: not utf-8", tmp_path)


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
