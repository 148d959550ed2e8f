"""Measure the cost of a command and all it starts: wall time, and peak memory on the GPU and on the host."""

from __future__ import annotations

import contextlib
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from msb.base.extras import need_extra
from msb.base.version import __version__
from msb.bench.checked import Amount, Count, Record, checked, read_json
from msb.bench.nvml import Gpu, Gpus
from msb.bench.records import RendererTiming
from msb.errors import InputError

INTERVAL = 0.2
WHOLE_COMMAND = "whole command, loading and writing included"
_MAX_BYTES = 1 << 20
_FORWARDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2")


class Track(Record):
    """The record of one command, schema msb.track/1. Times are in UTC, in the form of ISO 8601."""

    schema_: Literal["msb.track/1"] = Field(default="msb.track/1", alias="schema")
    command: tuple[str, ...]
    started: str
    ended: str
    seconds: Amount
    # The command's exit status, or 128 + n if signal n ended it.
    exit_status: int
    # The most bytes that all GPUs together held at one look.
    peak_gpu_memory_bytes: Count | None
    # "processes": the memory that NVML reports for the command's processes. "device": the memory that the
    # whole device held beyond what it held before, if NVML cannot tell processes apart on every GPU; other
    # programs on the device falsify this number.
    gpu_source: Literal["processes", "device"] | None
    # The reason why there is no number.
    gpu_reason: str | None
    gpus: tuple[Gpu, ...]
    # The most bytes of RAM that the command and its descendants held at one look: the sum of their resident
    # sets.
    peak_host_memory_bytes: Count | None
    # Seconds between two looks; a shorter peak can be missed.
    interval_seconds: Amount
    machine: dict[str, Any]
    tool_version: str


def read_track(path: Path) -> Track:
    """Return the record in the file `path`."""
    return checked(Track, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID")


def timing_of_command(found: Track, frames: int) -> RendererTiming:
    """Return what a command that drew `frames` images says of its renderer: a bound of its time."""
    device = ", ".join(gpu.name for gpu in found.gpus) or str(found.machine.get("host", "unknown"))
    return RendererTiming(
        frames=frames,
        seconds=found.seconds,
        device=device,
        timed=WHOLE_COMMAND,
        whole_command=True,
        peak_gpu_memory_bytes=found.peak_gpu_memory_bytes,
    )


def track(command: Sequence[str], *, interval: float = INTERVAL) -> Track:
    """Run a program with its arguments, without a shell, and return what it cost.

    It gets this process's own standard streams, and signals that this process receives meanwhile. `interval`
    is in seconds, between two looks at its memory.
    """
    need_extra("bench", "psutil", what="tracking a command")
    gpus = Gpus()
    started, start = datetime.now(UTC), time.perf_counter()
    with _forwarding() as begin:
        try:
            child = subprocess.Popen(list(command))
        except FileNotFoundError as error:
            raise InputError("FILE_NOT_FOUND", "there is no such program", file=command[0]) from error
        except OSError as error:
            text = f"it cannot be run: {error.strerror}"
            raise InputError("FILE_UNREADABLE", text, file=command[0]) from error
        begin(child)
        watch = _Watch(child.pid, gpus, interval)
        watch.start()
        status = child.wait()
    seconds = time.perf_counter() - start
    watch.stop()
    peak, source, reason = gpus.result()
    return Track(
        # Arguments need not be text; records must be.
        command=tuple(word.encode(errors="backslashreplace").decode() for word in command),
        started=started.isoformat(timespec="seconds"),
        ended=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=seconds,
        exit_status=status if status >= 0 else 128 - status,
        peak_gpu_memory_bytes=peak,
        gpu_source=source,
        gpu_reason=reason,
        gpus=gpus.devices(),
        peak_host_memory_bytes=watch.peak or None,
        interval_seconds=interval,
        machine={"system": platform.platform(), "cores": os.cpu_count(), "host": platform.node()},
        tool_version=__version__,
    )


class _Watch(threading.Thread):
    """Look at a process and its descendants until told to stop."""

    def __init__(self, pid: int, gpus: Gpus, interval: float) -> None:
        super().__init__(daemon=True)
        self._pid, self._gpus, self._interval = pid, gpus, interval
        self._done = threading.Event()
        self.peak = 0

    def run(self) -> None:
        """Look at the memory and wait, again and again."""
        while True:
            pids = self._look()
            self._gpus.look(pids)
            if self._done.wait(self._interval):
                return

    def stop(self) -> None:
        """Stop looking."""
        self._done.set()
        self.join()

    def _look(self) -> set[int]:
        import psutil

        try:
            parent = psutil.Process(self._pid)
            family = [parent, *parent.children(recursive=True)]
        except psutil.Error:
            return set()
        resident = 0
        for process in family:
            with contextlib.suppress(psutil.Error):
                resident += process.memory_info().rss
        self.peak = max(self.peak, resident)
        return {process.pid for process in family}


@contextlib.contextmanager
def _forwarding() -> Iterator[Callable[[subprocess.Popen[bytes]], None]]:
    """Pass signals on to the child that the function yielded is told of; only the main thread can.

    One that comes before there is a child waits for it: the child may be running before we know of it. One
    that is ignored here, as under nohup, stays so: with a handler, the child would not ignore it.
    """
    children: list[subprocess.Popen[bytes]] = []
    early: list[int] = []

    def send(number: int) -> None:
        with contextlib.suppress(OSError, ValueError):  # Windows knows few signals
            children[0].send_signal(number)

    def forward(number: int, _frame: object) -> None:
        if not children:
            early.append(number)
        # An interrupt from the keyboard went to all processes of the terminal's foreground group already.
        elif number != signal.SIGINT or not _in_foreground():
            send(number)

    def begin(child: subprocess.Popen[bytes]) -> None:
        children.append(child)
        for number in early:
            send(number)

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in _FORWARDED:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) != signal.SIG_IGN:
                before[number] = signal.signal(number, forward)
    try:
        yield begin
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _in_foreground() -> bool:
    """Return whether this process belongs to the foreground group of its terminal.

    On Windows an interrupt goes to all processes of a console, so that it always does.
    """
    if sys.platform == "win32":
        return True
    try:
        terminal = os.open("/dev/tty", os.O_RDONLY)
    except OSError:
        return False
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False
    finally:
        os.close(terminal)
