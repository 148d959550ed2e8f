"""Outputs that appear whole or not at all.

They are written beside their place under a temporary name, then renamed.
"""

from __future__ import annotations

import contextlib
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
def new_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yield a binary file that takes the place of `path` when the block ends without an error.

    Missing parent folders are made. On any failure the temporary file is removed and `path` is as before.

    Raises
    ------
    OutputError
        `OUTPUT_UNWRITABLE`, for any `OSError` in the block or the renaming.
    """
    target = _target(path)
    temporary = _beside(target)
    try:
        with _translated(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.is_dir():
                raise OutputError("OUTPUT_UNWRITABLE", "it is a folder; a file is to be written", file=target)
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
def new_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path` when the block ends without an error.

    The old folder or file is moved aside, the new one moved in, the old one removed.

    Raises
    ------
    OutputError
        `OUTPUT_UNWRITABLE`, for any `OSError` in the block or the renaming.
    """
    target = _target(path)
    temporary, aside = _beside(target), _beside(target)
    try:
        with _translated(target):
            target.parent.mkdir(parents=True, exist_ok=True)
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
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    finally:
        if os.path.lexists(target):
            _remove(aside)


_LEFTOVER = re.compile(r"\..{1,50}\.[0-9a-f]{12}\.part", re.DOTALL)


def remove_leftovers(folder: str | os.PathLike[str]) -> None:
    """Remove what writers that were killed left below `folder`; nobody may be writing there."""
    for root, folders, files in os.walk(folder):
        for name in [name for name in (*folders, *files) if _LEFTOVER.fullmatch(name)]:
            _remove(Path(root, name))
        folders[:] = [name for name in folders if not _LEFTOVER.fullmatch(name)]


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


@contextlib.contextmanager
def _translated(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be written: {reason}", file=target) from error
