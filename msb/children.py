"""Child processes of our own modules: how one is started, ended, and what is said of how it ended.

Foreign code that may hang or crash runs in one, so that it costs what it was asked and nothing else.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.errors import shorten

if TYPE_CHECKING:
    from collections.abc import Mapping


def module_command(module: str, *words: str) -> list[str]:
    """Return the command line of a child that runs `module` of this package."""
    # -P: a file in the current folder that is named like a module must not be run in its stead.
    return [sys.executable or "python3", "-P", "-m", module, *words]


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the variables of a child, which finds this package whatever its folder is."""
    root = str(Path(__file__).resolve().parents[1])
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


def last_line(text: str, limit: int = 200) -> str:
    """Return the last line of what a child printed that is not empty, shortened."""
    lines = (line.strip() for line in reversed(text.split("\n")))
    return shorten(next((line for line in lines if line), ""), limit)
