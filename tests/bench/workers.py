"""Functions for tests of worker processes, which must be able to import them."""

import os
import signal
import time
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def execute(task: str) -> str:
    """Return the task, raise ValueError ("raise TEXT"), or kill this process ("die").

    "once FILE" kills the process only if FILE does not exist, and creates it.
    """
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
    """Create a file named by the process number, then sleep for longer than any test runs."""
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)
