"""Only regular files are opened. For other files all readers raise the same two codes."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from msb.base.files import file_sha256, map_file, read_file, regular_file
from msb.errors import InputError
from msb.meshes import read_mesh
from msb.metrics import read_image

OPENERS: dict[str, Callable[[Path], Any]] = {
    "regular_file": regular_file,
    "read_file": read_file,
    "map_file": map_file,
    "file_sha256": file_sha256,
    "a mesh": read_mesh,
    "an image": read_image,
}


@pytest.fixture
def places(tmp_path: Path) -> dict[str, Path]:
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "device.ply").symlink_to("/dev/zero")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.ply")
    names = ("folder.ply", "device.ply", "pipe.ply", "none.ply", "file/x.ply", "nul\0.ply")
    return {name: tmp_path / name for name in names}


@pytest.mark.parametrize("opener", OPENERS)
def test_only_regular_files_are_opened(opener: str, places: dict[str, Path]) -> None:
    for name, path in places.items():
        with pytest.raises(InputError) as caught:
            OPENERS[opener](path)
        special = name in ("folder.ply", "device.ply", "pipe.ply")
        assert caught.value.code == ("FILE_UNREADABLE" if special else "FILE_NOT_FOUND")
        assert caught.value.file == str(path)


def test_read_file_returns_one_byte_more_than_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert [read_file(path, most) for most in (None, 5, 4, 0)] == [b"12345", b"12345", b"12345", b"1"]


def test_a_file_is_hashed_and_mapped_whole(tmp_path: Path) -> None:
    path, seen = tmp_path / "a", list[int]()
    for data in (b"", b"x" * 5_000_000):
        path.write_bytes(data)
        seen.clear()
        assert file_sha256(path, seen.append) == hashlib.sha256(data).hexdigest()
        assert sum(seen) == len(data)
        assert bytes(map_file(path)) == data


@pytest.mark.parametrize("opener", OPENERS)
def test_a_pointer_of_git_lfs_is_named(opener: str, tmp_path: Path) -> None:
    path = tmp_path / "model.ply"
    beginning = b"version https://git-lfs.github.com/spec/v1\n"
    path.write_bytes(beginning + b"oid sha256:" + b"0" * 64 + b"\nsize 248000000\n")
    with pytest.raises(InputError, match="git lfs") as caught:
        OPENERS[opener](path)
    assert caught.value.code == "FILE_UNREADABLE"
    path.write_bytes(beginning + b"x" * 2000)
    assert read_file(path).startswith(beginning)
