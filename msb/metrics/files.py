"""Files that metrics read, opened only if they are regular ones."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from msb.errors import InputError, shorten

if TYPE_CHECKING:
    import os


def regular_file(path: str | os.PathLike[str]) -> Path:
    """Return `path` if it is a file that can be read; a folder, pipe or device is never opened.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    """
    place = Path(path)
    try:
        place.stat()
        if not place.is_file():
            kind = "a folder" if place.is_dir() else "a pipe, socket or device"
            raise InputError("FILE_UNREADABLE", f"it is {kind}; it must be a regular file", file=place)
        with place.open("rb"):
            return place
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError("FILE_NOT_FOUND", "there is no such file", file=place) from error
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL
        reason = (error.strerror if isinstance(error, OSError) else str(error)) or "it cannot be opened"
        raise InputError("FILE_UNREADABLE", f"it cannot be read: {reason}", file=place) from error


def reason(error: Exception) -> str:
    """Return why a library could not read a file, from what it raised: damage shows as any exception.

    Also as lack of memory, where a few bytes declare gigabytes.
    """
    if isinstance(error, MemoryError):
        return "this machine has not enough memory for what it declares"
    return shorten(str(error) or type(error).__name__)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of the file's bytes, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
