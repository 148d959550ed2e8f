"""Functions for the child processes of test_children.py, of the type `msb.base.children.Work`."""

import errno
import os
import subprocess
import sys
import time
from typing import Any

import numpy as np

from msb.base.children import Arrays

Result = tuple[Any, Arrays]


def describe(word: str, arrays: Arrays) -> Result:
    """Return the arguments and the doubled arrays, and write a file into the current folder."""
    shapes = {name: [array.dtype.str, *array.shape] for name, array in arrays.items()}
    print("libraries print")
    with open("left behind", "w", encoding="ascii"):  # noqa: PTH123
        return {"word": word, "arrays": shapes}, {name: 2 * array for name, array in arrays.items()}


def misbehave(word: str, arrays: Arrays) -> Result:
    """Fail in the way that `word` selects, such as a hang or a crash."""
    if word == "hang":
        time.sleep(600)
    elif word == "hang with a child":
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        with open(os.environ["TMPDIR"] + "/pid", "w", encoding="ascii") as file:  # noqa: PTH123
            file.write(str(child.pid))
        time.sleep(600)
    elif word == "raise":
        raise ValueError("there are holes")
    elif word == "abort":
        os.abort()
    elif word == "exit":
        sys.exit("x" * 10_000)
    elif word == "no JSON":
        return float("nan"), {}
    elif word == "half a reply":
        with open("reply.json", "w", encoding="ascii") as file:  # noqa: PTH123
            file.write('{"why": ""')
        os._exit(0)
    elif word == "bad_alloc":
        sys.stderr.write("std::bad_alloc")
        os.abort()
    elif word == "memory of NumPy":
        return None, {"ones": np.ones(1 << 29)}
    elif word == "full disk":
        np.lib.format.write_array = _refuse
        return None, {"a": np.ones(3)}
    return word, {}


def _refuse(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "no room")
