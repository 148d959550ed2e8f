"""Tasks for worker processes: they must be importable, so they cannot stand in a test."""

import os
import signal
import time
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def moody(task: str) -> str:
    """Do what the task says: return, raise, die, or die only the first time (a file remembers)."""
    kind, _, rest = task.partition(" ")
    if kind == "raise":
        raise ValueError(rest)
    if kind == "die" or (kind == "once" and not Path(rest).exists()):
        if kind == "once":
            Path(rest).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return task


def linger(folder: str) -> None:
    """Write our process number, then go on for longer than any test waits."""
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)
