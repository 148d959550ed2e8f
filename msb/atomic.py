"""Outputs that appear whole or not at all.

They are written beside their place under a temporary name, then renamed.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from pathlib import Path
from typing import IO, TYPE_CHECKING

from msb.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Yield a binary file that takes the place of `path` when the block ends without an error.

    Missing parent folders are made. On any failure the temporary file is removed and `path` is as before.

    Raises
    ------
    OutputError
        `OUTPUT_UNWRITABLE`, for any `OSError` in the block or the renaming.
    """
    target = Path(path)
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
        temporary.unlink(missing_ok=True)
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
    target = Path(path)
    temporary, aside = _beside(target), _beside(target)
    try:
        with _translated(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.mkdir()
            yield temporary
            if os.path.lexists(target):
                target.rename(aside)
            try:
                temporary.rename(target)
            except OSError:
                if os.path.lexists(aside):
                    aside.rename(target)
                raise
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    finally:
        if os.path.lexists(target):
            _remove(aside)


def _beside(target: Path) -> Path:
    return target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def _translated(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be written: {reason}", file=target) from error
