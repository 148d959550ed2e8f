"""Functions of ours that are called in child processes of their own, with limits.

Foreign code that may hang, crash or take too much memory runs in one, so that it costs what was asked of it
and nothing else. Arguments and results travel as files in a temporary folder.
"""

import contextlib
import errno
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.base.atomic import DISK_ERRORS, room_for_temporaries
from msb.base.files import read_file
from msb.base.limits import Limits
from msb.base.npz import write_npy
from msb.errors import shorten

Arrays = Mapping[str, NDArray[Any]]
# A function of a module: it takes a word and named arrays, and returns JSON data and named arrays.
Work = Callable[[str, Arrays], tuple[Any, Arrays]]
_POLL = 0.02
_REPLY, _ERRORS = "reply.json", "errors"
_MOST_REPLY, _MOST_ERRORS = 1 << 26, 1 << 16
# The status of a child that could not write what it made: EX_IOERR of sysexits.h.
_UNWRITTEN = 74
_OF_MEMORY = re.compile(r"MemoryError|bad_alloc|[Oo]ut of memory|[Cc]annot allocate|Unable to allocate")
# A constant of linux/prctl.h.
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Reply:
    """What became of a call.

    `why` says why there is neither data nor arrays, in the words of the exception or ours; it is empty where
    there are. `ended_by` says what ended a call that did not end by itself. `seconds` are those that the
    function took, or its limit; None where the process died.
    """

    data: Any = None
    arrays: Arrays = field(default_factory=dict)
    why: str = ""
    ended_by: Literal["time", "memory", "crash"] | None = None
    seconds: float | None = None


def run_apart(work: Work, word: str, arrays: Arrays, limits: Limits) -> Reply:
    """Call `work(word, arrays)` in a process of its own.

    The process is ended at its limit, by whatever ends this call (an interrupt, an error), and with this
    process.
    """
    return run_each(work, [word], arrays, limits)[word]


def run_each(
    work: Work, words: Sequence[str], arrays: Arrays, limits: Limits, *, at_once: int = 1
) -> dict[str, Reply]:
    """Call `work(word, arrays)` for each word as `run_apart` does, so many at once."""
    replies: dict[str, Reply] = {}
    running: dict[str, tuple[subprocess.Popen[bytes], Path, float]] = {}
    waiting = list(words)
    with _shared_folder() as folder:
        _give(arrays, folder)
        try:
            while waiting or running:
                while waiting and len(running) < at_once:
                    word, own = waiting.pop(0), folder / str(len(waiting))
                    running[word] = _start(work, word, own, limits), own, time.monotonic() + limits.seconds
                for word, (child, own, deadline) in list(running.items()):
                    if child.poll() is not None:
                        replies[word] = _reply(own, child.returncode, limits)
                    elif time.monotonic() > deadline:
                        why = f"it did not end within {limits.seconds:g} s"
                        replies[word] = Reply(why=why, ended_by="time", seconds=limits.seconds)
                    else:
                        continue
                    _end(running.pop(word)[0])
                if running:
                    time.sleep(_POLL)
        finally:
            for child, _, _ in running.values():
                _end(child)
    return replies


def apart() -> dict[str, Any]:
    """Return the options of `subprocess.Popen` for a child that Ctrl-C does not reach.

    The parent ends it. On POSIX it gets a session of its own, on Windows a process group.
    """
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def _start(work: Work, word: str, folder: Path, limits: Limits) -> subprocess.Popen[bytes]:
    folder.mkdir()
    # -P: a file in the current folder that is named like a module must not be run in its stead.
    command = [sys.executable or "python3", "-P", "-m", "msb.base.children"]
    function = f"{work.__module__}:{work.__qualname__}"
    root = str(Path(__file__).resolve().parents[2])  # where the child finds this package
    path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    with (folder / _ERRORS).open("wb") as errors:
        return subprocess.Popen(
            [*command, function, word, str(folder), str(limits.memory or 0)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # libraries print
            stderr=errors,
            env={**os.environ, "PYTHONPATH": path},
            cwd=folder,
            **apart(),
        )


def _end(child: subprocess.Popen[bytes]) -> None:
    """End a child and what it has started, if it is still running, and wait until it is gone."""
    if child.poll() is None:
        if sys.platform == "win32":
            child.kill()
        else:
            os.killpg(child.pid, signal.SIGKILL)
    child.wait()


def _reply(folder: Path, status: int, limits: Limits) -> Reply:
    if status == _UNWRITTEN:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    printed = _printed(folder)
    try:
        reply = json.loads(read_file(folder / _REPLY, _MOST_REPLY))
        why, seconds = str(reply["why"]), float(reply["seconds"])
        if not why:
            made = {path.stem: np.load(path, allow_pickle=False) for path in folder.glob("*.npy")}
            return Reply(reply["data"], made, seconds=seconds)
    except Exception:  # it wrote none, or not all of it
        how, seconds = f"status {status}", None
        with contextlib.suppress(ValueError):
            how = signal.Signals(-status).name
        lines = [line.strip() for line in printed.splitlines() if line.strip()]
        why = f"it crashed ({how})" + (f": {shorten(lines[-1], 200)}" if lines else "")
    if limits.memory is not None and _OF_MEMORY.search(f"{why}\n{printed}"):
        return Reply(
            why=f"it needs more memory than {limits.memory:g} GiB", ended_by="memory", seconds=seconds
        )
    return Reply(why=why, ended_by="crash" if seconds is None else None, seconds=seconds)


def _printed(folder: Path) -> str:
    """Return the end of what a child wrote to standard error."""
    with (folder / _ERRORS).open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - _MOST_ERRORS))
        return file.read().decode(errors="replace")


@contextlib.contextmanager
def _shared_folder() -> Iterator[Path]:
    """Yield a temporary folder for what children are given and what they leave."""
    with (
        room_for_temporaries(),
        tempfile.TemporaryDirectory(prefix="msb-apart-", ignore_cleanup_errors=True) as name,
    ):
        yield Path(name)


def _give(arrays: Arrays, folder: Path) -> None:
    (folder / "given").mkdir()
    for name, array in arrays.items():
        write_npy(folder / "given" / f"{name}.npy", array)


def check_room(arrays: Arrays) -> None:
    """Refuse at once a temporary folder without room for what children will be given, OUTPUT_UNWRITABLE."""
    with _shared_folder() as folder:
        _give(arrays, folder)


def _serve(function: str, word: str, folder: Path, memory: float) -> None:
    """Do what a child does: call the function, and leave the reply in `folder`."""
    module, _, name = function.partition(":")
    if sys.platform == "linux":
        _end_with_parent()
    work: Work = getattr(import_module(module), name)
    given = {path.stem: np.load(path, allow_pickle=False) for path in (folder.parent / "given").glob("*.npy")}
    if memory and sys.platform == "linux":
        _limit_memory(memory)
    data: Any = None
    arrays: Arrays = {}
    why = ""
    start = time.perf_counter()
    try:
        data, arrays = work(word, given)
    except Exception as error:  # the library's words are the result
        why = shorten(f"{error}" or type(error).__name__, 200)
        if isinstance(error, MemoryError):
            why = f"MemoryError: {why}"
    reply = {"data": data, "why": why, "seconds": time.perf_counter() - start}
    text = json.dumps(reply, allow_nan=False)
    try:
        for name, array in arrays.items():
            write_npy(folder / f"{name}.npy", array)
        (folder / "partial").write_text(text, "utf-8")
        (folder / "partial").rename(folder / _REPLY)
    except OSError as error:
        if error.errno in DISK_ERRORS:
            raise SystemExit(_UNWRITTEN) from error
        raise


def _end_with_parent() -> None:
    """Let Linux kill this process when its parent ends in whatever way."""
    import ctypes

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _limit_memory(gib: float) -> None:
    """Hold this process to `gib` GiB.

    RLIMIT_DATA counts what may be written to. RLIMIT_AS would also count what libraries only reserve, such
    as the arenas of threads, and end them far below the memory they take.
    """
    import resource

    most = int(gib * 2**30)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


if __name__ == "__main__":
    _serve(sys.argv[1], sys.argv[2], Path(sys.argv[3]), float(sys.argv[4]))
