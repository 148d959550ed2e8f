"""Names inside an asset, and safe opening of the files behind them."""

from __future__ import annotations

import mmap
import os
import re
import stat
from pathlib import Path

from msb.asset.manifest import MANIFEST_NAME
from msb.base.files import READ_ONLY, is_missing, map_descriptor, special_kind, system_reason
from msb.errors import AssetError

_BUFFER_FILE = re.compile(r"buffers/[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}\.bin\Z")


def is_member_name(name: str) -> bool:
    """Return whether `name` is one a member of an asset may have."""
    return name == MANIFEST_NAME or _BUFFER_FILE.match(name) is not None


def map_member(path: Path, member: str, *, asset: object) -> tuple[mmap.mmap | bytes, os.stat_result]:
    """Return a read-only mapping of the file `member` of `asset`, which lies at `path`, and its status.

    A link, pipe, device or folder is refused before it is opened; the open descriptor is checked again.
    """
    try:
        _refuse_special(path.lstat(), asset, member)
        descriptor = _open(path, member)
        try:
            status = os.fstat(descriptor)
            _refuse_special(status, asset, member)
            return map_descriptor(descriptor), status
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:
        if is_missing(error):
            code = "TRIASSET_MANIFEST_MISSING" if member == MANIFEST_NAME else "TRIASSET_DAMAGED"
            raise AssetError(code, f"there is no {member} in it", file=asset, pointer=member) from error
        text = f"{member} cannot be read: {system_reason(error)}"
        raise AssetError("TRIASSET_FILE_UNREADABLE", text, file=asset, pointer=member) from error


def _open(path: Path, member: str) -> int:
    """Return a descriptor of `path`; no link is followed, not even one put there just now."""
    flags = READ_ONLY | getattr(os, "O_NOFOLLOW", 0)
    if "/" not in member or os.open not in os.supports_dir_fd:
        return os.open(path, flags)
    folder = os.open(path.parent, flags | os.O_DIRECTORY)
    try:
        return os.open(path.name, flags, dir_fd=folder)
    finally:
        os.close(folder)


def _refuse_special(status: os.stat_result, asset: object, member: str) -> None:
    if stat.S_ISLNK(status.st_mode):
        raise AssetError("TRIASSET_PATH", f"{member} is a symbolic link", file=asset, pointer=member)
    if kind := special_kind(status):
        text = f"{member} is {kind}; it must be a regular file"
        raise AssetError("TRIASSET_PATH", text, file=asset, pointer=member)
