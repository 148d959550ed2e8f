"""Functions for tests of worker processes, which import them and therefore cannot find them in a test."""

import os
import signal
import time
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def obey(task: str) -> str:
    """Return, raise or die, as the task says; "once FILE" dies the first time only and creates the file."""
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
    """Create a file named by the process number, then wait for longer than any test does."""
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)
