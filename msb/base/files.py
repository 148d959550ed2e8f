"""Files that somebody else may have prepared: opened only if they are regular ones, with errors of ours."""

import contextlib
import hashlib
import mmap
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from msb.base.paths import given_path
from msb.errors import InputError, shorten

# Flags of `os.open`. They do not block, because a file that was replaced by a pipe a moment ago must not be
# waited for.
READ_ONLY = (
    os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
)
_CHUNK = 1 << 22


def regular_file(path: str | os.PathLike[str]) -> Path:
    """Return `path` if it is a file that can be read; a folder, pipe or device is never opened."""
    place = given_path(path)
    with _opened(place):
        return place


def read_file(path: str | os.PathLike[str], most: int | None = None) -> bytes:
    """Return the content of a regular file; if it is longer than `most` bytes, its first `most` + 1 bytes."""
    with _opened(given_path(path)) as descriptor, open(descriptor, "rb", closefd=False) as file:
        return file.read() if most is None else file.read(most + 1)


def map_file(path: Path, most: int | None = None) -> mmap.mmap | bytes:
    """Return a read-only mapping of a regular file, or of its first `most` bytes."""
    with _opened(path) as descriptor:
        return map_descriptor(descriptor, most)


def file_sha256(path: Path, advance: Callable[[int], None] | None = None) -> str:
    """Return the SHA-256 of a regular file's bytes, in hexadecimal digits; `advance` is told bytes done."""
    digest = hashlib.sha256()
    with _opened(path) as descriptor:
        while chunk := os.read(descriptor, _CHUNK):
            digest.update(chunk)
            if advance is not None:
                advance(len(chunk))
    return digest.hexdigest()


def is_file(path: Path) -> bool:
    """Return whether `path` is a file we may look at; unlike `Path.is_file`, never raises."""
    with contextlib.suppress(OSError, ValueError):
        return path.is_file()
    return False


def is_folder(path: Path) -> bool:
    """Return whether `path` is a folder we may look at; unlike `Path.is_dir`, never raises."""
    with contextlib.suppress(OSError, ValueError):
        return path.is_dir()
    return False


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    """Yield a descriptor of the regular file at `path`: looked at before it is opened and again after."""
    try:
        _refuse_special(path.stat(), path)
        descriptor = os.open(path, READ_ONLY)
        try:
            _refuse_special(os.fstat(descriptor), path)
            yield descriptor
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:
        raise open_error(error, path) from error


def _refuse_special(status: os.stat_result, path: Path) -> None:
    if kind := special_kind(status):
        raise InputError("FILE_UNREADABLE", f"it is {kind}; it must be a regular file", file=path)


def special_kind(status: os.stat_result) -> str | None:
    """Return in words what kind of thing lies there, or None if it is a regular file."""
    if stat.S_ISREG(status.st_mode):
        return None
    return "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, socket or device"


def map_descriptor(descriptor: int, most: int | None = None) -> mmap.mmap | bytes:
    """Return a read-only mapping of an open file, or bytes for an empty file, which cannot be mapped."""
    length = 0 if most is None else min(most, os.fstat(descriptor).st_size)
    try:
        return mmap.mmap(descriptor, length, access=mmap.ACCESS_READ)
    except ValueError:
        return b""


def open_error(error: OSError | ValueError, path: object, what: str = "file") -> InputError:
    """Return the error of ours for a failed look at `path`, which should be a `what`."""
    if is_missing(error):
        return InputError("FILE_NOT_FOUND", f"there is no such {what}", file=path)
    return InputError("FILE_UNREADABLE", f"it cannot be read: {system_reason(error)}", file=path)


def check_folder(path: Path, what: str = "folder") -> None:
    """Refuse what is no folder, or not there."""
    if not is_folder(path):
        if os.path.lexists(path):
            raise InputError("FILE_UNREADABLE", f"it is no {what}", file=path)
        raise InputError("FILE_NOT_FOUND", f"there is no such {what}", file=path)


def is_missing(error: OSError | ValueError) -> bool:
    """Return whether an error says that nothing is there.

    A `ValueError` is about names that no file can have: with a NUL, or half of a surrogate pair.
    """
    return isinstance(error, FileNotFoundError | NotADirectoryError | ValueError)


def system_reason(error: OSError | ValueError) -> str:
    """Return the operating system's words for an error."""
    return getattr(error, "strerror", None) or "it cannot be opened"


def library_reason(error: Exception) -> str:
    """Return why a library could not read a file, from the exception that it raised.

    A damaged file can cause any exception, also a lack of memory, where a few bytes declare gigabytes.
    """
    if isinstance(error, MemoryError):
        return "this machine has not enough memory for what it declares"
    return shorten(str(error) or type(error).__name__)
