"""Folders of results: replaced files, other files, and the state after an error."""

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from msb.base.own_folder import LIST, check_own_folder, listed_files, own_folder
from msb.errors import OutputError, UsageError


def write(folder: Path, *names: str, overwrite: bool = True) -> None:
    """Write files that contain their names."""
    with own_folder(folder, overwrite=overwrite) as new:
        for name in names:
            (new / name).parent.mkdir(exist_ok=True)
            (new / name).write_text(name)


def contents(folder: Path) -> dict[str, str]:
    """Return the text of each file in a folder by its name, without the list of files."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != LIST)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder of an earlier run with additional files, a link and an empty folder of a user."""
    folder = tmp_path / "out"
    write(folder, "a", "b", "sub/c")
    (folder / "mine").write_text("mine")
    (folder / "sub" / "mine").write_text("mine")
    (folder / "link").symlink_to("mine")
    (folder / "empty").mkdir()
    return folder


def test_listed_files_are_replaced_or_removed_and_all_others_stay(folder: Path) -> None:
    (folder / "a").write_text("changed")
    write(folder, "a", "d")
    assert contents(folder) == {"a": "a", "d": "d", "mine": "mine", "sub/mine": "mine", "link": "mine"}
    assert (folder / "link").is_symlink()
    assert (folder / "empty").is_dir()
    assert listed_files(folder) == {"a", "d"}


def test_without_hard_links_others_are_copied(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_links(*_: Any, **__: Any) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", no_links)
    write(folder, "a")
    assert contents(folder) == {"a": "a", "mine": "mine", "sub/mine": "mine", "link": "mine"}
    assert (folder / "link").is_symlink()


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), OSError(errno.ENOSPC, "full")])
@pytest.mark.parametrize("step", ["writing", "keeping"])
def test_after_a_failure_the_old_folder_is_whole(
    folder: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException, step: str
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise failure

    before, files = contents(folder), listed_files(folder)
    if step == "keeping":
        monkeypatch.setattr(os, "link", fail)
        monkeypatch.setattr(shutil, "copy2", fail)
    wanted = OutputError if isinstance(failure, OSError) else KeyboardInterrupt
    with pytest.raises(wanted), own_folder(folder) as new:  # noqa: PT012 - the block has to fail
        (new / "a").write_text("new")
        if step == "writing":
            fail()
    assert (contents(folder), listed_files(folder)) == (before, files)
    assert [path.name for path in folder.parent.iterdir()] == ["out"]


def test_a_new_file_does_not_replace_a_file_of_a_user(folder: Path) -> None:
    before = contents(folder)
    for name in ("mine", "sub"):
        with pytest.raises((UsageError, OutputError)):
            write(folder, name)
    assert contents(folder) == before


def test_a_link_to_a_folder_stays_a_link(folder: Path) -> None:
    link = folder.parent / "link"
    link.symlink_to("out")
    write(link, "a")
    assert link.is_symlink()
    assert listed_files(folder) == {"a"}
    assert (folder / "mine").exists()


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"schema": "other/1", "files": ["a"]}', '{"schema": "msb.files/1"}', "[" * 99999],
)
def test_a_folder_without_a_valid_list_is_not_written(tmp_path: Path, text: str) -> None:
    (tmp_path / "a").write_text("mine")
    (tmp_path / LIST).write_text(text)
    with pytest.raises(UsageError) as caught:
        check_own_folder(tmp_path)
    assert caught.value.code == "OUTPUT_EXISTS"
    with pytest.raises(UsageError):
        write(tmp_path, "a")
    assert contents(tmp_path) == {"a": "mine"}


def test_a_file_and_a_folder_that_may_not_be_replaced_stay(folder: Path) -> None:
    file = folder / "mine"
    for place, overwrite in ((file, True), (folder, False)):
        with pytest.raises(UsageError) as caught:
            write(place, "a", overwrite=overwrite)
        assert caught.value.code == "OUTPUT_EXISTS"
    assert json.loads((folder / LIST).read_text())["files"] == ["a", "b", "sub/c"]
