"""Atomic writes: after any failure the old file or folder is unchanged."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from msb.base.atomic import check_place, is_leftover, new_file, new_files, new_folder, remove_leftovers
from msb.errors import OutputError, UsageError
from tests.conftest import ROOT
from tests.robustness.conftest import Bound, bound, read_only

if TYPE_CHECKING:
    from collections.abc import Callable


__all__ = ["bound", "read_only"]

KINDS = pytest.mark.parametrize("kind", ["file", "folder"])
FULL = OSError(errno.ENOSPC, "No space left on device")
BROKEN = OSError(errno.EIO, "Input/output error")


def write(path: Path, kind: str, content: bytes = b"new", size: int | None = None) -> None:
    if kind == "file":
        with new_file(path, size=size) as file:
            file.write(content)
    else:
        with new_folder(path, size=size) as folder:
            (folder / "a").write_bytes(content)


def fail_half_way(path: Path, kind: str, error: BaseException) -> None:
    with (new_file if kind == "file" else new_folder)(path) as place:
        if isinstance(place, Path):
            (place / "half").write_bytes(b"half")
        else:
            place.write(b"half")
        raise error


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files in a folder, by relative path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_only_an_empty_folder_is_replaced(tmp_path: Path) -> None:
    place, link = tmp_path / "place", tmp_path / "link"
    place.mkdir()
    link.symlink_to("place")
    with pytest.raises(UsageError, match="OUTPUT_EXISTS"), new_folder(place, overwrite=False):
        (place / "theirs").write_bytes(b"precious")
    assert read_files(tmp_path) == {"place/theirs": b"precious"}
    (place / "theirs").unlink()
    for path in (link, place):
        with new_folder(path, overwrite=False) as folder:
            (folder / "a").write_bytes(b"new")
    assert read_files(tmp_path) == {"place/a": b"new", "link/a": b"new"}
    assert {path.name for path in tmp_path.iterdir()} == {"place", "link"}
    assert not link.is_symlink()


def raiser(error: BaseException, after: int = 0) -> Callable[..., Any]:
    """Return a replacement of a system call that works `after` times and then raises `error`."""
    calls = iter(range(after + 1))

    def fail(*_args: object, **_keywords: object) -> None:
        if next(calls, None) == after:
            raise error

    return fail


@KINDS
def test_existing_outputs_are_replaced_and_parents_created(kind: str, tmp_path: Path) -> None:
    for content in (b"old", b"new"):
        write(tmp_path / "x" / "y", kind, content)
        assert read_files(tmp_path) == {"x/y" if kind == "file" else "x/y/a": content}


@KINDS
@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("error", [FULL, BROKEN, KeyboardInterrupt(), MemoryError(), ValueError()], ids=repr)
def test_a_failure_while_writing(kind: str, old: bool, error: BaseException, tmp_path: Path) -> None:
    if old:
        write(tmp_path / "a", kind, b"old")
    before = read_files(tmp_path)
    known = OutputError if isinstance(error, OSError) else type(error)
    with pytest.raises(known):
        fail_half_way(tmp_path / "a", kind, error)
    assert read_files(tmp_path) == before
    assert len(list(tmp_path.iterdir())) == old


@pytest.mark.parametrize(
    ("kind", "owner", "call"),
    [
        ("file", os, "fsync"),
        ("file", Path, "replace"),
        ("file", Path, "open"),
        ("folder", Path, "mkdir"),
        ("folder", Path, "rename"),
    ],
)
@pytest.mark.parametrize("error", [FULL, BROKEN, KeyboardInterrupt()], ids=repr)
def test_a_call_of_the_system_fails(
    kind: str, owner: Any, call: str, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "a", kind, b"old")
    before = read_files(tmp_path)
    after = call == "mkdir"  # the first call creates the parents
    monkeypatch.setattr(owner, call, raiser(error, after))
    with pytest.raises(OutputError if isinstance(error, OSError) else KeyboardInterrupt):
        write(tmp_path / "a", kind)
    monkeypatch.undo()
    assert read_files(tmp_path) == before
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("error", [BROKEN, KeyboardInterrupt()], ids=repr)
def test_the_old_folder_is_restored_if_renaming_fails(
    error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "a", "folder", b"old")
    rename, calls = Path.rename, []

    def fail_second(path: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) == 2:
            raise error
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fail_second)
    with pytest.raises(OutputError if isinstance(error, OSError) else KeyboardInterrupt):
        write(tmp_path / "a", "folder")
    assert (read_files(tmp_path), len(calls)) == ({"a/a": b"old"}, 3)


@KINDS
@pytest.mark.parametrize("links", [True, False])
def test_without_overwrite_existing_outputs_are_kept(
    kind: str, links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(Path, "hardlink_to", refuse)
    make = new_file if kind == "file" else new_folder
    (tmp_path / "old").write_bytes(b"theirs")
    for place in (tmp_path / "old", tmp_path / "new"):
        with pytest.raises(UsageError, match="OUTPUT_EXISTS"), make(place, overwrite=False):
            (tmp_path / "new").write_bytes(b"theirs")
    with make(tmp_path / "free", overwrite=False):
        pass
    assert (tmp_path / "free").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["free", "new", "old"]
    assert {(tmp_path / name).read_bytes() for name in ("old", "new")} == {b"theirs"}


def test_only_one_of_eight_writers_creates_a_file(tmp_path: Path) -> None:
    together = threading.Barrier(8)

    def create(number: int) -> str:
        try:
            with new_file(tmp_path / "a", overwrite=False) as file:
                file.write(str(number).encode())
                together.wait()
        except UsageError as error:
            return error.code
        return str(number)

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(create, range(8)))
    (winner,) = set(results) - {"OUTPUT_EXISTS"}
    assert results.count("OUTPUT_EXISTS") == 7
    assert read_files(tmp_path) == {"a": winner.encode()}


@pytest.mark.parametrize("kind", ["file", "folder", "files"])
def test_created_folders_are_removed_after_a_failure(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine").mkdir()

    def fail(path: Path) -> None:
        if kind != "files":
            fail_half_way(path, kind, FULL)
        with new_files([path, path.with_name("b")]):
            raise FULL

    for folder in (Path("mine"), Path("new"), Path("mine", "new", "newer")):
        with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
            fail(folder / "a")
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]
    write(Path("mine", "new", "a"), "file")
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
        fail(Path("mine", "new", "b"))
    assert read_files(tmp_path) == {"mine/new/a": b"new"}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_the_error_reports_free_and_needed_space(number: int, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"[\d,]+ bytes .* 7 are"):  # noqa: SIM117
        with new_file(tmp_path / "a", size=7):
            raise OSError(number, os.strerror(number))


_KILLED = """
import os, sys
from pathlib import Path
from msb.base.atomic import new_file, new_folder
path, kind, number = sys.argv[1:]
with (new_file if kind == "file" else new_folder)(path) as place:
    half = (place / "a").open("wb") if kind == "folder" else place
    half.write(b"half")
    half.flush()
    os.kill(os.getpid(), int(number))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
@KINDS
def test_a_process_that_is_killed(kind: str, tmp_path: Path) -> None:
    write(tmp_path / "a", kind, b"old")
    before = read_files(tmp_path)
    line = [sys.executable, "-c", _KILLED, str(tmp_path / "a"), kind, str(int(signal.SIGKILL))]
    assert subprocess.run(line, cwd=ROOT, check=False).returncode == -signal.SIGKILL
    assert [is_leftover(path.name) for path in sorted(tmp_path.iterdir())] == [True, False]
    remove_leftovers(tmp_path)
    assert read_files(tmp_path) == before
    write(tmp_path / "a", kind)
    assert list(read_files(tmp_path).values()) == [b"new"]


@KINDS
@pytest.mark.parametrize("name", ["a\0b", "", ".", "..", "/", "\ud800", "x" * 300, "file/a", "file/x/a"])
def test_a_name_that_cannot_be_written(
    kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_bytes(b"kept")
    with pytest.raises(OutputError) as of_writing:
        write(Path(name), kind)
    with pytest.raises(OutputError) as of_checking:
        check_place(name, folder=kind == "folder")
    assert str(of_writing.value).isprintable()
    assert str(of_checking.value).isprintable()
    assert read_files(tmp_path) == {"file": b"kept"}


@KINDS
@pytest.mark.parametrize("name", ["\u3042" * 85, "\U0001f600" * 63, "x" * 255])
def test_the_longest_names(kind: str, name: str, tmp_path: Path) -> None:
    write(tmp_path / name, kind)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_files_and_folders_in_the_way(tmp_path: Path) -> None:
    write(tmp_path / "file", "file", b"kept")
    write(tmp_path / "folder", "folder", b"kept")
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
        write(tmp_path / "file" / "new" / "a", "file")
    for attempt in (check_place, lambda path: write(path, "file")):
        with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
            attempt(tmp_path / "folder")
    assert set(read_files(tmp_path).values()) == {b"kept"}
    write(tmp_path / "file", "folder")
    assert read_files(tmp_path) == {"file/a": b"new", "folder/a": b"kept"}


@pytest.mark.skipif(os.name == "nt", reason="links need special rights on Windows")
@KINDS
def test_a_link_is_replaced_and_its_target_is_kept(kind: str, tmp_path: Path) -> None:
    (tmp_path / "kept").write_bytes(b"kept")
    for name, leads_to in (("dangling", "nowhere"), ("link", "kept")):
        (tmp_path / name).symlink_to(leads_to)
        write(tmp_path / name, kind)
        assert not (tmp_path / name).is_symlink()
    assert (tmp_path / "kept").read_bytes() == b"kept"
    assert not (tmp_path / "nowhere").exists()


_REFUSED = """
import sys
from msb.base.atomic import check_place, new_file, new_folder
from msb.errors import OutputError, UsageError
for attempt in (check_place, lambda path: check_place(path, folder=True), new_file, new_folder):
    try:
        with attempt(sys.argv[1]):
            pass
    except OutputError as error:
        print(error)
"""


def test_a_folder_that_may_not_be_written_into(bound: Bound, read_only: Path) -> None:
    status, out, _ = bound("-c", _REFUSED, read_only / "a")
    assert (status, out.count(f"OUTPUT_UNWRITABLE: {read_only / 'a'}: ")) == (0, 4)
    assert not list(read_only.iterdir())
