"""What a process that is fed hostile bytes may not do; doing it ends the process at once."""

from __future__ import annotations

import os
import resource
import site
import sys
import sysconfig
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

MEMORY = 2 << 30
"""Bytes of address space, all that the interpreter and its libraries take included."""
FORBIDDEN_STATUS = 99
_FORBIDDEN = (
    "subprocess.",
    "socket.",
    "pty.",
    "urllib.",
    "ftplib.",
    "shutil.",
    "webbrowser.",
    "pickle.find_class",
    "code.__new__",
    "function.__new__",
    "ctypes.dlopen",
    "os.system",
    "os.exec",
    "os.fork",
    "os.posix_spawn",
    "os.spawn",
    "os.startfile",
    "os.kill",
    "os.symlink",
    "os.link",
)
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = (
    "os.remove",
    "os.rename",
    "os.mkdir",
    "os.rmdir",
    "os.truncate",
    "os.chmod",
    "os.chown",
    "os.utime",
)


def limit_memory() -> None:
    """Cap this process's address space."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


class Guard:
    """Forbid this process, while the ``with`` block runs, what reading a file must never do.

    It may write below `scratch` only, and run no code that is not installed: modules may still be imported.
    `report` is told what was done, and where, before the process ends; an exception could be caught.
    """

    def __init__(self, scratch: Path, report: Callable[[str], None]) -> None:
        folders = {*sysconfig.get_paths().values(), *site.getsitepackages(), str(Path.cwd())}
        self._code = (*folders, "<frozen ")
        self._inside = os.path.realpath(scratch) + os.sep
        self._report = report
        self._active = False
        sys.addaudithook(self._hook)

    def __enter__(self) -> None:
        self._active = True

    def __exit__(self, *error: object) -> None:
        self._active = False

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._active:
            return
        if event == "exec":
            # Source that came with the input has no file among the installed ones.
            name = getattr(arguments[0], "co_filename", "")
            if not name.startswith(self._code):
                self._end(f"exec of code from {name!r}")
        elif event == "open":
            name, _, flags = arguments
            writes = isinstance(flags, int) and flags & _WRITES
            if writes and not (isinstance(name, int) or self._is_below(name)):
                self._end(f"{name!r} opened for writing")
        elif event in _CHANGES:
            if not self._is_below(arguments[0]):
                self._end(f"{event} {arguments!r:.200}")
        elif event.startswith(_FORBIDDEN):
            self._end(f"{event} {arguments!r:.200}")

    def _is_below(self, name: object) -> bool:
        if not isinstance(name, str | bytes | os.PathLike):
            return False
        return os.path.realpath(os.fsdecode(name)).startswith(self._inside)

    def _end(self, what: str) -> None:
        self._active = False  # the report is written by this process, too
        self._report(f"forbidden: {what}\n" + "".join(traceback.format_stack()))
        os._exit(FORBIDDEN_STATUS)
