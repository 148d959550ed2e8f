"""What is special about files of cameras that are not valid; tests/corpus reads all of them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

import msb
from msb.errors import InputError, SceneError

from .bad_cameras import SMALL
from .builders import write


@pytest.mark.skipif(sys.platform == "win32", reason="needs links and pipes")
def test_links_are_followed_but_pipes_are_not(tmp_path: Path) -> None:
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
