"""Rename a file or folder to a name that nothing has."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from pathlib import Path

_AT_FDCWD, _RENAME_NOREPLACE = -100, 1
"""Constants of linux/fcntl.h and linux/fs.h."""
_RENAME_EXCL = 4
"""A constant of stdio.h on macOS."""


def rename_to_new(source: Path, target: Path) -> None:
    """Rename a file or folder to a name that nothing has; of two that do so at once one fails.

    Linux and macOS have a call for this, and Windows' own renaming is one. A file system that does not know
    it (NFS) mostly has hard links, which do the same for files. Where there is neither, the name is first
    taken by an empty file or folder: still one of two fails, but for a moment, or after a kill in it, that is
    what is there.
    """
    if os.name == "nt":
        source.rename(target)
        return
    if _renamed_by_the_system(source, target):
        return
    if source.is_dir():
        target.mkdir()
    else:
        try:
            target.hardlink_to(source)
        except FileExistsError:
            raise
        except OSError:
            target.touch(exist_ok=False)
        else:
            source.unlink()
            return
    try:
        source.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            target.rmdir() if target.is_dir() else target.unlink()
        raise


def _renamed_by_the_system(source: Path, target: Path) -> bool:
    """Return whether the system renamed, by a call that replaces nothing; False if that is not known here."""
    import ctypes

    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(source), os.fsencode(target)
    try:
        if sys.platform == "darwin":
            failed = library.renamex_np(*names, _RENAME_EXCL)
        else:
            failed = library.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_NOREPLACE)
    except AttributeError:  # another C library
        return False
    if failed and ctypes.get_errno() == errno.EEXIST:
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    return not failed
