"""Outputs that appear whole or not at all.

An output is written beside its place under a temporary name, then renamed. A device or a pipe is written
through, because nothing can take its place.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, cast

from msb.base.renaming import rename_to_new
from msb.errors import OutputError, UsageError


@contextlib.contextmanager
def new_file(
    path: str | os.PathLike[str], *, size: int | None = None, overwrite: bool = True
) -> Iterator[BinaryIO]:
    """Yield a binary file that takes the place of `path` when the block ends without an error.

    Missing parent folders are made. On any failure the temporary file is removed and `path` is as before.
    A symbolic link at `path` is itself replaced, not what it points to; only one that leads to a device or
    pipe is followed (`is_stream`).

    Parameters
    ----------
    path : path-like
    size : int, optional
        Bytes that will be written, if known; the error about a full disk then says how many.
    overwrite : bool
        What is there may be replaced; a device or pipe is written through in any case.
    """
    target = _target(path)
    if is_stream(target):
        with _translated(target, None), _written_through(target) as file:
            yield file
        return
    temporary = _beside(target)
    with _translated(target, size):
        try:
            _refuse_existing(target, overwrite)
            _make_parent(target)
            if target.is_dir():
                raise OutputError("OUTPUT_UNWRITABLE", _IS_FOLDER, file=target)
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if not _moved_to_free_place(temporary, target, overwrite):
                temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise


@contextlib.contextmanager
def new_folder(
    path: str | os.PathLike[str], *, size: int | None = None, overwrite: bool = True
) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path` when the block ends without an error.

    The old folder or file is moved aside, the new one moved in, the old one removed.

    Parameters
    ----------
    path : path-like
    size : int, optional
    overwrite : bool
        The same as for `new_file`.
    """
    target = _target(path)
    temporary, aside = _beside(target), _beside(target)
    with _translated(target, size):
        try:
            _refuse_stream(target)
            _refuse_existing(target, overwrite)
            _make_parent(target)
            temporary.mkdir()
            yield temporary
            try:
                if not _moved_to_free_place(temporary, target, overwrite):
                    if os.path.lexists(target):
                        target.rename(aside)
                    temporary.rename(target)
            except BaseException:
                if os.path.lexists(aside) and not os.path.lexists(target):
                    aside.rename(target)
                raise
        except BaseException as error:
            shutil.rmtree(temporary, ignore_errors=True)
            if isinstance(error, OutputError) and error.file is not None:
                error = _about_target(error, temporary, target)
            raise error
        finally:
            if os.path.lexists(target):
                _remove(aside)


def _about_target(error: OutputError, temporary: Path, target: Path) -> OutputError:
    """Return the error of a file in the temporary folder as one of the file it would have become."""
    file = Path(str(error.file))
    if not file.is_relative_to(temporary):
        return error
    return error.at(target / file.relative_to(temporary))


def check_place(path: str | os.PathLike[str], *, folder: bool = False, free: bool = False) -> None:
    """Refuse a place where nothing can be written, before hours are spent on what should go there.

    Parameters
    ----------
    path : path-like
        The path of a file or folder to be written; its parent folders need not exist.
    folder : bool
        Whether a folder is to be written.
    free : bool
        Whether nothing is there yet. What another program writes there later must then not be replaced:
        `new_file` and `new_folder` write only where there still is nothing, until `forget_free_places`.
    """
    target = _target(path)
    if is_stream(target):
        if folder:
            _refuse_stream(target)
        if not os.access(target, os.W_OK):
            text = f"it cannot be written: {os.strerror(errno.EACCES)}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)
        return
    if free:
        _FREE.add(os.path.abspath(target))  # noqa: PTH100 - the name itself, not what a link there leads to
    with _translated(target, None):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            target.lstat()  # which leaves: a name too long
        above = _above(target)
        _check_folder(target, above)
        if not os.access(above, os.W_OK | os.X_OK):
            text = f"it cannot be written: {os.strerror(errno.EACCES)}: {above}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


def forget_free_places() -> None:
    """Allow outputs at places that were found free to be replaced again; called at the end of a command."""
    _FREE.clear()


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Return whether what is at `path` can only be written through, never be replaced.

    These are devices, pipes and sockets, also by way of a link, and files this process holds open by their
    descriptor: ``/dev/stdout``, ``/dev/fd/63``, ``/proc/self/fd/3``, whatever they lead to.
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return False
    return not stat.S_ISDIR(mode) and (not stat.S_ISREG(mode) or _descriptor(path) is not None)


DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""What a write fails with where the place is at fault: no room, or no way to write there."""
_FREE: set[str] = set()
"""Places where nothing was when `check_place` looked."""
_IS_FOLDER = "it is a folder; a file is to be written"
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT}
_LEFTOVER = re.compile(r"\..{1,50}\.[0-9a-f]{12}\.part", re.DOTALL)


def is_leftover(name: str) -> bool:
    """Return whether a name is that of a temporary file or folder: a leftover, if no writer is at work."""
    return _LEFTOVER.fullmatch(name) is not None


def remove_leftovers(folder: str | os.PathLike[str]) -> None:
    """Remove what writers that were killed left below `folder`; nobody may be writing there."""
    for root, folders, files in os.walk(folder):
        for name in [name for name in (*folders, *files) if is_leftover(name)]:
            _remove(Path(root, name))
        folders[:] = [name for name in folders if not is_leftover(name)]


def _target(path: str | os.PathLike[str]) -> Path:
    """Return `path` if a file system could hold something of that name."""
    target = Path(path)
    try:
        possible = target.name not in ("", "..") and b"\0" not in os.fsencode(target)
    except UnicodeEncodeError:  # half of a surrogate pair
        possible = False
    if not possible:
        raise OutputError("OUTPUT_UNWRITABLE", "this is no name a file or folder can have", file=path)
    return target


def _descriptor(path: str | os.PathLike[str]) -> int | None:
    """Return the number of the open file of this process that `path` is another name of."""
    place = Path(os.path.abspath(path))  # noqa: PTH100 - see check_place
    if str(place.parent) == "/dev" and place.name in _STANDARD:
        return _STANDARD.index(place.name)
    opened = ("/dev/fd", f"/proc/{os.getpid()}/fd")
    return int(place.name) if place.name.isdecimal() and os.path.realpath(place.parent) in opened else None


@contextlib.contextmanager
def _written_through(target: Path) -> Iterator[BinaryIO]:
    """Yield a file, in which a writer may seek; when the block ends without an error it goes to `target`."""
    with tempfile.TemporaryFile() as file:
        yield cast("BinaryIO", file)
        file.seek(0)
        number = _descriptor(target)
        if number == 1:
            sys.stdout.flush()
        # A descriptor goes on where it is; opened by its name a regular file would be written from its start.
        flags = os.O_WRONLY | getattr(os, "O_BINARY", 0)
        number = os.open(target, flags) if number is None else os.dup(number)
        with os.fdopen(number, "wb") as stream:
            shutil.copyfileobj(file, stream)


def _refuse_stream(target: Path) -> None:
    if is_stream(target):
        text = "it is a device or pipe; a folder is to be written"
        raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


def _refuse_existing(target: Path, overwrite: bool) -> None:
    if not overwrite and os.path.lexists(target):
        raise UsageError("OUTPUT_EXISTS", "it exists; overwrite=True replaces it", file=target)


def _moved_to_free_place(temporary: Path, target: Path, overwrite: bool) -> bool:
    """Move in, if the place was found free and still is; return False if what is there may be replaced."""
    place = os.path.abspath(target)  # noqa: PTH100 - see check_place
    if overwrite and place not in _FREE:
        return False
    try:
        rename_to_new(temporary, target)
    except FileExistsError as error:
        how = "--force" if overwrite else "overwrite=True"
        text = f"it was made while this ran, by another program; {how} replaces it"
        raise UsageError("OUTPUT_EXISTS", text, file=target) from error
    _FREE.discard(place)
    return True


_STANDARD = ("stdin", "stdout", "stderr")


def _beside(target: Path) -> Path:
    # 50 characters take at most 200 bytes: with what is added, still a name that fits into 255.
    return target.with_name(f".{target.name[:50]}.{secrets.token_hex(6)}.part")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


def _make_parent(target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        _check_folder(target, _above(target))
        raise


def _above(target: Path) -> Path:
    """Return the nearest thing above the target that exists."""
    return next((place for place in target.parents if os.path.lexists(place)), Path())


def _check_folder(target: Path, above: Path) -> None:
    """Refuse what lies above the target but is no folder; the system's own words would be "File exists"."""
    if not above.is_dir():
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be written: {above} is no folder", file=target)


@contextlib.contextmanager
def _translated(target: Path, size: int | None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in _NO_SPACE:
            reason += _space(target, size)
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be written: {reason}", file=target) from error


def _space(target: Path, size: int | None) -> str:
    """Return how much there is, and is needed if that is known; to be asked once the temporary is removed."""
    try:
        free = shutil.disk_usage(target.parent).free
    except OSError:
        return ""
    return f" ({free:,} bytes are free" + ("" if size is None else f", {size:,} are needed") + ")"
