"""Call functions in child processes with limits of time and memory.

Other libraries can hang, crash or exhaust the memory. In a child process, a crash of a library does not end
the main process. Arguments and results are exchanged as files in a temporary folder.
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
# A module-level function that takes a word and named arrays, and returns JSON data and named arrays.
Work = Callable[[str, Arrays], tuple[Any, Arrays]]
# Seconds between two checks of running processes. Starting Python alone takes at least 0.3 s.
_POLL = 0.02
# Names of the two files that a child process writes: its result, and its standard error.
_REPLY, _ERRORS = "reply.json", "errors"
# Maximum number of bytes read from the result and from the standard error of a child process.
_MOST_REPLY, _MOST_ERRORS = 1 << 26, 1 << 16
# Exit status of a child process that could not write its result: EX_IOERR of sysexits.h.
_UNWRITTEN = 74
_OF_MEMORY = re.compile(r"MemoryError|bad_alloc|[Oo]ut of memory|[Cc]annot allocate|Unable to allocate")
# A constant from linux/prctl.h.
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Reply:
    """The result of a call, or the reason why the call failed."""

    # The two values that the function returned.
    data: Any = None
    arrays: Arrays = field(default_factory=dict)
    # The reason why the call failed, such as the text of its exception. The reason is empty if the call
    # succeeded.
    why: str = ""
    # The reason for the early end of a call: its time limit, its memory limit, or a crash.
    ended_by: Literal["time", "memory", "crash"] | None = None
    # Run time of the function in seconds. If the call reached the time limit, the value is the time limit.
    # After a crash, the value is None.
    seconds: float | None = None


def run_in_child(work: Work, word: str, arrays: Arrays, limits: Limits) -> Reply:
    """Call `work(word, arrays)` in a child process, and return its result.

    The child process is killed when it reaches a limit, when this call is interrupted, and when this
    process ends.
    """
    return run_in_children(work, [word], arrays, limits)[word]


def run_in_children(
    work: Work, words: Sequence[str], arrays: Arrays, limits: Limits, *, at_once: int = 1
) -> dict[str, Reply]:
    """Call `work(word, arrays)` for each word in a child process, with at most `at_once` processes at a
    time."""
    replies: dict[str, Reply] = {}
    running: dict[str, tuple[subprocess.Popen[bytes], Path, float]] = {}
    waiting = list(words)
    with _shared_folder() as folder:
        _write_arguments(arrays, folder)
        try:
            while waiting or running:
                # Start processes until `at_once` of them run.
                while waiting and len(running) < at_once:
                    word, place = waiting.pop(0), folder / str(len(waiting))
                    running[word] = (
                        _start(work, word, place, limits),
                        place,
                        time.monotonic() + limits.seconds,
                    )
                # Collect the results of processes that ended or reached the time limit.
                for word, (child, place, deadline) in list(running.items()):
                    if child.poll() is not None:
                        replies[word] = _read_reply(place, child.returncode, limits)
                    elif time.monotonic() > deadline:
                        why = f"the process timed out after {limits.seconds:g} s"
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


def detached_options() -> dict[str, Any]:
    """Return options of `subprocess.Popen` that keep Ctrl-C away from the child process. The parent process
    must end the child.

    The child process gets a new session on POSIX, and a new process group on Windows.
    """
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def _start(work: Work, word: str, folder: Path, limits: Limits) -> subprocess.Popen[bytes]:
    folder.mkdir()
    # The option -P prevents imports from the current folder.
    command = [sys.executable or "python3", "-P", "-m", "msb.base.children"]
    function = f"{work.__module__}:{work.__qualname__}"
    root = str(Path(__file__).resolve().parents[2])  # ensures that the child process imports the same msb
    path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    with (folder / _ERRORS).open("wb") as errors:
        return subprocess.Popen(
            [*command, function, word, str(folder), str(limits.memory or 0)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # libraries print
            stderr=errors,
            env={**os.environ, "PYTHONPATH": path},
            cwd=folder,
            **detached_options(),
        )


def _end(child: subprocess.Popen[bytes]) -> None:
    """Kill a running child process and the processes that it started, and wait for its end."""
    if child.poll() is None:
        if sys.platform == "win32":
            child.kill()
        else:
            os.killpg(child.pid, signal.SIGKILL)
    child.wait()


def _read_reply(folder: Path, status: int, limits: Limits) -> Reply:
    """Return the result in the folder of a child process, or the reason why the call failed."""
    if status == _UNWRITTEN:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    printed = _read_errors(folder)
    try:
        reply = json.loads(read_file(folder / _REPLY, _MOST_REPLY))
        why, seconds = str(reply["why"]), float(reply["seconds"])
        if not why:
            arrays = {path.stem: np.load(path, allow_pickle=False) for path in folder.glob("*.npy")}
            return Reply(reply["data"], arrays, seconds=seconds)
    except Exception:  # the result is missing or incomplete, because the child process crashed
        how, seconds = f"status {status}", None
        with contextlib.suppress(ValueError):
            how = signal.Signals(-status).name
        lines = [line.strip() for line in printed.splitlines() if line.strip()]
        why = f"the process crashed ({how})" + (f": {shorten(lines[-1], 200)}" if lines else "")
    if limits.memory is not None and _OF_MEMORY.search(f"{why}\n{printed}"):
        return Reply(
            why=f"the process needs more memory than {limits.memory:g} GiB",
            ended_by="memory",
            seconds=seconds,
        )
    return Reply(why=why, ended_by="crash" if seconds is None else None, seconds=seconds)


def _read_errors(folder: Path) -> str:
    """Return the end of a child process's standard error as text."""
    with (folder / _ERRORS).open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - _MOST_ERRORS))
        return file.read().decode(errors="replace")


@contextlib.contextmanager
def _shared_folder() -> Iterator[Path]:
    """Yield a temporary folder for the arguments and results of child processes."""
    with (
        room_for_temporaries(),
        tempfile.TemporaryDirectory(prefix="msb-apart-", ignore_cleanup_errors=True) as name,
    ):
        yield Path(name)


def _write_arguments(arrays: Arrays, folder: Path) -> None:
    """Write the arrays that all child processes read."""
    (folder / "given").mkdir()
    for name, array in arrays.items():
        write_npy(folder / "given" / f"{name}.npy", array)


def check_room(arrays: Arrays) -> None:
    """Check that the temporary folder has room for the arrays that child processes read.

    Raises
    ------
    OutputError
        OUTPUT_UNWRITABLE.
    """
    with _shared_folder() as folder:
        _write_arguments(arrays, folder)


def _serve(function: str, word: str, folder: Path, memory: float) -> None:
    """Call the function in this child process, and write its result into `folder`."""
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
    except Exception as error:  # the text of the error is reported as the reason
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
    """Make Linux kill this process when its parent ends for any reason."""
    import ctypes

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _limit_memory(gib: float) -> None:
    """Limit the memory of this process to `gib` GiB.

    RLIMIT_DATA limits writable memory. RLIMIT_AS would be too strict, because it also counts address space
    that libraries only reserve, such as memory arenas of threads.
    """
    import resource

    most = int(gib * 2**30)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


if __name__ == "__main__":
    _serve(sys.argv[1], sys.argv[2], Path(sys.argv[3]), float(sys.argv[4]))
