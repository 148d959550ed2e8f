"""Open files of untrusted origin: regular files only, with the errors of this project."""

import contextlib
import hashlib
import mmap
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from msb.base.paths import given_path
from msb.errors import InputError, shorten

# Flags of `os.open`. With O_NONBLOCK, opening does not wait if another program has replaced the file by a
# pipe.
READ_ONLY = (
    os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
)
# The beginning of a Git LFS pointer, and its maximum size in bytes (git-lfs: docs/spec.md).
_BEGINNING, _MAX_POINTER = b"version https://git-lfs.github.com/spec/", 1024
POINTER = "the file is a pointer of Git LFS, not the file itself; fetch the file with git lfs pull"
# Number of bytes that are read and hashed at a time. Reading larger pieces is not faster.
_CHUNK = 1 << 22


def regular_file(path: str | os.PathLike[str]) -> Path:
    """Return `path` if it is a readable regular file. Folders, pipes and devices are not opened."""
    place = given_path(path)
    with _open_regular(place):
        return place


def read_file(path: str | os.PathLike[str], most: int | None = None) -> bytes:
    """Return at most the first `most` + 1 bytes of a regular file."""
    with _open_regular(given_path(path)) as descriptor, open(descriptor, "rb", closefd=False) as file:
        return file.read() if most is None else file.read(most + 1)


def map_file(path: Path, most: int | None = None) -> mmap.mmap | bytes:
    """Return a read-only mapping of a regular file, or of its first `most` bytes."""
    with _open_regular(path) as descriptor:
        return map_descriptor(descriptor, most)


def file_sha256(path: Path, advance: Callable[[int], None] | None = None) -> str:
    """Return the SHA-256 of a regular file's bytes, in hexadecimal digits.

    `advance` is called with the size of each hashed piece.
    """
    digest = hashlib.sha256()
    with _open_regular(path) as descriptor:
        while chunk := os.read(descriptor, _CHUNK):
            digest.update(chunk)
            if advance is not None:
                advance(len(chunk))
    return digest.hexdigest()


def is_file(path: Path) -> bool:
    """Return whether `path` is an accessible file. Unlike `Path.is_file`, this function never raises an
    error."""
    with contextlib.suppress(OSError, ValueError):
        return path.is_file()
    return False


def is_folder(path: Path) -> bool:
    """Return whether `path` is an accessible folder. Unlike `Path.is_dir`, this function never raises an
    error."""
    with contextlib.suppress(OSError, ValueError):
        return path.is_dir()
    return False


@contextlib.contextmanager
def _open_regular(path: Path) -> Iterator[int]:
    """Yield a descriptor of the regular file at `path`.

    The kind of the file is checked before and after opening.
    """
    try:
        _reject_special(path.stat(), path)
        descriptor = os.open(path, READ_ONLY)
        try:
            _reject_special(os.fstat(descriptor), path)
            if is_pointer(descriptor):
                raise InputError("FILE_UNREADABLE", POINTER, file=path)
            yield descriptor
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:
        raise open_error(error, path) from error


def _reject_special(status: os.stat_result, path: Path) -> None:
    if kind := special_kind(status):
        raise InputError("FILE_UNREADABLE", f"the path is {kind}; name a regular file", file=path)


def is_pointer(descriptor: int) -> bool:
    """Return whether an open file is a Git LFS pointer: a small text in place of the real file."""
    if os.fstat(descriptor).st_size > _MAX_POINTER:
        return False
    beginning = os.read(descriptor, len(_BEGINNING))
    os.lseek(descriptor, 0, os.SEEK_SET)
    return beginning == _BEGINNING


def special_kind(status: os.stat_result) -> str | None:
    """Return the kind of a file that is not regular, such as "a folder", or None for a regular file."""
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
    """Convert an operating system error about `path` to an error of msb.

    The message names the kind of path, `what`, such as "file".
    """
    if is_missing(error):
        return InputError("FILE_NOT_FOUND", f"this {what} does not exist", file=path)
    return InputError("FILE_UNREADABLE", f"the file cannot be read: {system_reason(error)}", file=path)


def check_folder(path: Path, what: str = "folder") -> None:
    """Check that `path` is an existing folder. The message names the kind of path, `what`."""
    if not is_folder(path):
        if os.path.lexists(path):
            raise InputError("FILE_UNREADABLE", f"the path is not a {what}", file=path)
        raise InputError("FILE_NOT_FOUND", f"this {what} does not exist", file=path)


def is_missing(error: OSError | ValueError) -> bool:
    """Return whether an error means that the file does not exist.

    Python raises a `ValueError` for a name that contains a NUL or half of a surrogate pair.
    """
    return isinstance(error, FileNotFoundError | NotADirectoryError | ValueError)


def system_reason(error: OSError | ValueError) -> str:
    """Return the operating system's text for an error."""
    return getattr(error, "strerror", None) or "the file cannot be opened"


def library_reason(error: Exception) -> str:
    """Return the reason for an exception of a library that failed to read a file.

    A damaged file can cause any exception. A damaged file can also exhaust the memory, because a few bytes
    can declare gigabytes.
    """
    if isinstance(error, MemoryError):
        return "this machine does not have enough memory for the size that the file declares"
    return shorten(str(error) or type(error).__name__)
