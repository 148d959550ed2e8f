"""Guard for processes that read hostile bytes: a forbidden action ends the process at once."""

from __future__ import annotations

import os
import resource
import site
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

MEMORY = 1 << 30
"""Allowed growth of the address space in bytes, in addition to the interpreter and its libraries."""
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


_HARMLESS = ("os.scandir", "os.listdir")


def limit_memory() -> None:
    """Limit the address space of this process."""
    most = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def peak_mib(status: Iterable[str]) -> int:
    """Return the peak resident memory of this process from the lines of /proc/self/status.

    The peak of `getrusage` is inherited from the parent process, and pytest may be large.
    """
    return next(int(line.split()[1]) >> 10 for line in status if line.startswith("VmHWM"))


class Guard:
    """Forbid all actions that a reader must never take, while the ``with`` block runs.

    The process may write only below `scratch`, and run only installed code. It may still import modules.
    Before the process ends, `report` receives the action and its place. No exception is raised, because the
    reader could catch it.
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
            # Code from the input does not belong to an installed file.
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
        self._active = False  # allow this process to write the report
        self._report(f"forbidden: {what}\n" + "".join(traceback.format_stack()))
        os._exit(FORBIDDEN_STATUS)


class ClosedGuard(Guard):
    """A guard that also forbids imports, the execution of new code, and all files except `inside` and files
    below it.

    Modules that readers import on first use must be imported in advance.
    """

    inside = ""

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._active:
            return
        if event == "open":
            name, mode, flags = arguments
            if isinstance(name, int):
                return  # an already open descriptor
            # The path is relative to the folder that is read. The hook does not get the descriptor of an
            # opened folder.
            path = os.path.normpath(os.path.join(self.inside, os.fsdecode(name)))  # noqa: PTH118
            writes = isinstance(flags, int) and flags & _WRITES
            if writes or not (path + os.sep).startswith(self.inside + os.sep):
                self._end(f"{name!r} opened with mode {mode!r} and flags {flags!r}")
        elif event.startswith(("import", "exec", "compile", "ctypes.", "os.")) and event not in _HARMLESS:
            self._end(f"{event} {arguments!r:.200}")
        else:
            super()._hook(event, arguments)
