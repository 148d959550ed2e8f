"""Outputs that appear whole or not at all.

They are written beside their place under a temporary name, then renamed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from msb.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str], *, size: int | None = None) -> Iterator[BinaryIO]:
    """Yield a binary file that takes the place of `path` when the block ends without an error.

    Missing parent folders are made. On any failure the temporary file is removed and `path` is as before.
    A symbolic link at `path` is itself replaced, not what it points to.

    Parameters
    ----------
    path : path-like
    size : int, optional
        Bytes that will be written, if known: the error of a full disk then tells.

    Raises
    ------
    OutputError
        `OUTPUT_UNWRITABLE`, for any `OSError` in the block or the renaming.
    """
    target = _target(path)
    temporary = _beside(target)
    with _translated(target, size):
        try:
            _make_parent(target)
            if target.is_dir():
                raise OutputError("OUTPUT_UNWRITABLE", _IS_FOLDER, file=target)
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str], *, size: int | None = None) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path` when the block ends without an error.

    The old folder or file is moved aside, the new one moved in, the old one removed.

    Parameters
    ----------
    path : path-like
    size : int, optional
        As of `new_file`.

    Raises
    ------
    OutputError
        `OUTPUT_UNWRITABLE`, for any `OSError` in the block or the renaming.
    """
    target = _target(path)
    temporary, aside = _beside(target), _beside(target)
    with _translated(target, size):
        try:
            _make_parent(target)
            temporary.mkdir()
            yield temporary
            try:
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
    where = {"pointer": error.pointer, "value": error.value, "limit": error.limit}
    return OutputError(error.code, error.message, file=target / file.relative_to(temporary), **where)


def check_place(path: str | os.PathLike[str]) -> None:
    """Refuse a place where nothing can be written, before hours are spent on what should go there.

    Parameters
    ----------
    path : path-like
        Of a file or folder to be written; its parent folders need not exist.

    Raises
    ------
    OutputError
        `OUTPUT_UNWRITABLE`: the folder that would hold it, or the nearest one above that exists, cannot be
        written in or is none.
    """
    target = _target(path)
    with _translated(target, None):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            target.lstat()  # which leaves: a name too long
        above = _above(target)
        _check_folder(target, above)
        if not os.access(above, os.W_OK | os.X_OK):
            text = f"it cannot be written: {os.strerror(errno.EACCES)}: {above}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


_IS_FOLDER = "it is a folder; a file is to be written"
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT}
_LEFTOVER = re.compile(r"\..{1,50}\.[0-9a-f]{12}\.part", re.DOTALL)


def is_leftover(name: str) -> bool:
    """Return whether a file or folder has the name of a temporary one: nobody's, if no writer is at work."""
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
