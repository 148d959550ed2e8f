"""Names inside an asset, and safe opening of files that somebody else may have prepared."""

from __future__ import annotations

import mmap
import os
import re
import stat
from typing import TYPE_CHECKING

from msb.asset.manifest import MANIFEST_NAME
from msb.errors import AssetError, InputError, MsbError

if TYPE_CHECKING:
    from pathlib import Path

_BUFFER_FILE = re.compile(r"buffers/[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}\.bin\Z")


def is_member_name(name: str) -> bool:
    """Return whether `name` is one a member of an asset may have."""
    return name == MANIFEST_NAME or _BUFFER_FILE.match(name) is not None


def map_file(
    path: Path, *, asset: object, member: str | None = None
) -> tuple[mmap.mmap | bytes, os.stat_result]:
    """Return a read-only mapping of the regular file at `path` and its status.

    Parameters
    ----------
    path : Path
        A link, pipe, device or folder is refused before it is opened, and checked again on the descriptor.
    asset : path-like
        Named in errors.
    member : str, optional
        The name inside the asset; links are then refused. Without it `path` is what the user gave, and may
        be a link.

    Raises
    ------
    AssetError
        `TRIASSET_BUFFER_MISSING` or `TRIASSET_MANIFEST_MISSING`, `TRIASSET_PATH_LINK`,
        `TRIASSET_PATH_NOT_FILE`, `TRIASSET_FILE_UNREADABLE` when `member` is given.
    InputError
        `FILE_NOT_FOUND` or `FILE_UNREADABLE` otherwise.
    """
    try:
        status = path.lstat() if member is not None else path.stat()
        _refuse_special(status, asset, member)
        descriptor = _open(path, member)
    except (OSError, ValueError) as error:
        raise open_error(error, asset, member) from error
    try:
        status = os.fstat(descriptor)
        _refuse_special(status, asset, member)
        if status.st_size == 0:
            return b"", status
        return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ), status
    except (OSError, ValueError) as error:  # ValueError: the file was emptied since
        raise open_error(error, asset, member) from error
    finally:
        os.close(descriptor)


def _open(path: Path, member: str | None) -> int:
    """Return a descriptor of `path`; below an asset no link is followed, not even one put there just now."""
    flags = (
        os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
    )
    if member is None:
        return os.open(path, flags)
    flags |= getattr(os, "O_NOFOLLOW", 0)
    if "/" not in member or os.open not in os.supports_dir_fd:
        return os.open(path, flags)
    folder = os.open(path.parent, flags | os.O_DIRECTORY)
    try:
        return os.open(path.name, flags, dir_fd=folder)
    finally:
        os.close(folder)


def _refuse_special(status: os.stat_result, asset: object, member: str | None) -> None:
    if stat.S_ISREG(status.st_mode):
        return
    kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, socket or device"
    if member is None:
        raise InputError("FILE_UNREADABLE", f"it is {kind}; it must be a regular file", file=asset)
    if stat.S_ISLNK(status.st_mode):
        raise AssetError("TRIASSET_PATH_LINK", f"{member} is a symbolic link", file=asset, pointer=member)
    text = f"{member} is {kind}; it must be a regular file"
    raise AssetError("TRIASSET_PATH_NOT_FILE", text, file=asset, pointer=member)


def open_error(error: OSError | ValueError, asset: object, member: str | None) -> MsbError:
    """Return the error of ours for a failed look at `asset`, or at `member` in it.

    A `ValueError` comes from names that no file system takes: with a NUL, or half of a surrogate pair.
    """
    reason = (error.strerror if isinstance(error, OSError) else str(error)) or "it cannot be opened"
    missing = isinstance(error, FileNotFoundError | NotADirectoryError)
    if member is None:
        if missing:
            return InputError("FILE_NOT_FOUND", "there is no such file or folder", file=asset)
        return InputError("FILE_UNREADABLE", f"it cannot be read: {reason}", file=asset)
    if missing:
        code = "TRIASSET_MANIFEST_MISSING" if member == MANIFEST_NAME else "TRIASSET_BUFFER_MISSING"
        return AssetError(code, f"there is no {member} in it", file=asset, pointer=member)
    text = f"{member} cannot be read: {reason}"
    return AssetError("TRIASSET_FILE_UNREADABLE", text, file=asset, pointer=member)
