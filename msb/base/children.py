"""Child processes of our own modules: how one is started, ended, and what is said of how it ended.

Foreign code that may hang or crash runs in one, so that it costs what it was asked and nothing else.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from msb.base.atomic import DISK_ERRORS
from msb.errors import OutputError, shorten

_UNWRITTEN = 74
"""The status of a child that could not write what it made: EX_IOERR of sysexits.h."""


def module_command(module: str, *words: str) -> list[str]:
    """Return the command line of a child that runs `module` of this package."""
    # -P: a file in the current folder that is named like a module must not be run in its stead.
    return [sys.executable or "python3", "-P", "-m", module, *words]


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the variables of a child, which finds this package whatever its folder is."""
    root = str(Path(__file__).resolve().parents[2])
    path = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path), **(more or {})}


def apart() -> dict[str, Any]:
    """Return the options of `subprocess.Popen` for a child that Ctrl-C does not reach.

    The parent ends it. On POSIX it gets a session of its own, on Windows a process group.
    """
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def end(child: subprocess.Popen[bytes]) -> None:
    """End a child, if it is still running, and wait until it is gone."""
    if child.poll() is None:
        child.kill()
    child.wait()


def ending(status: int) -> str:
    """Return how a process ended: the signal that ended it, or its status."""
    if status < 0:
        with contextlib.suppress(ValueError):
            return signal.Signals(-status).name
    return f"status {status}"


@contextlib.contextmanager
def shared_folder(prefix: str) -> Iterator[Path]:
    """Yield a temporary folder for what a child is given and what it leaves."""
    try:
        with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name:
            yield Path(name)
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        text = f"temporary files cannot be written: {os.strerror(error.errno)}; TMPDIR names another folder"
        raise OutputError("OUTPUT_UNWRITABLE", text, file=tempfile.gettempdir()) from error


@contextlib.contextmanager
def leaving() -> Iterator[None]:
    """Let a child, which writes what it made in this block, end with a status of its own if it cannot."""
    try:
        yield
    except OSError as error:
        if error.errno in DISK_ERRORS:
            raise SystemExit(_UNWRITTEN) from error
        raise


def check_written(status: int) -> None:
    """Raise what `shared_folder` turns into our error, if a child ended because it could not write."""
    if status == _UNWRITTEN:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def last_line(text: str, limit: int = 200) -> str:
    """Return the last line of what a child printed that is not empty, shortened."""
    lines = (line.strip() for line in reversed(text.split("\n")))
    return shorten(next((line for line in lines if line), ""), limit)
