"""Measure wall time, peak GPU memory and peak RAM of a command and its child processes."""

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

from pydantic import ConfigDict, Field

from msb.base.extras import need_extra
from msb.base.version import __version__
from msb.bench.nvml import Gpu, Gpus
from msb.bench.records import RendererTiming
from msb.bench.validation import Amount, Count, Record, read_json, validate
from msb.errors import InputError

# Seconds between two memory measurements.
INTERVAL = 0.2
WHOLE_COMMAND = "whole command, including loading and writing"
# Maximum size of a record in bytes.
_MAX_BYTES = 1 << 20
_FORWARDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2")


class Track(Record):
    """The record of one command, schema msb.track/1. Times are in UTC and ISO 8601 format."""

    schema_: Literal["msb.track/1"] = Field(default="msb.track/1", alias="schema")
    command: tuple[str, ...]
    started: str
    ended: str
    seconds: Amount
    # The command's exit status, or 128 + n if signal n ended the command.
    exit_status: int
    # Peak of the memory summed over all GPUs, in bytes.
    peak_gpu_memory_bytes: Count | None
    # "processes" means the memory that NVML reports for the processes of the command. "device" means the
    # growth of memory on the whole device. The growth is used if NVML cannot distinguish the processes of
    # every GPU. The growth on the whole device includes other programs.
    gpu_source: Literal["processes", "device"] | None
    # The reason that the peak GPU memory is unknown.
    gpu_reason: str | None
    gpus: tuple[Gpu, ...]
    # Peak of the sum of the resident sets of the command and its child processes, in bytes.
    peak_host_memory_bytes: Count | None
    # Seconds between two memory measurements; a shorter peak may be missed.
    interval_seconds: Amount
    machine: dict[str, Any]
    tool_version: str


class TrainingLog(Record):
    """The file `training.json` of our trainer (docs/training.md). All other keys of the file are ignored."""

    model_config = ConfigDict(extra="ignore")

    method: str
    iterations: Count
    # Time of all iterations.
    seconds: Amount


def read_training_record(path: Path) -> Track | TrainingLog:
    """Return the record of a training in the file `path`, written by `msb track` or by our trainer."""
    data = read_json(path, _MAX_BYTES)
    if isinstance(data, dict) and "schema" not in data and data.keys() >= {"method", "iterations"}:
        return validate(TrainingLog, data, file=path, code="RECORD_INVALID")
    return read_track(path)


def read_track(path: Path) -> Track:
    """Return the record in the file `path`."""
    return validate(Track, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID")


def make_renderer_timing(record: Track, frames: int) -> RendererTiming:
    """Return the timing of a renderer whose command drew `frames` images.

    The timing of the whole command is an upper bound for the rendering time.
    """
    device = ", ".join(gpu.name for gpu in record.gpus) or str(record.machine.get("host", "unknown"))
    return RendererTiming(
        frames=frames,
        seconds=record.seconds,
        device=device,
        timed=WHOLE_COMMAND,
        whole_command=True,
        peak_gpu_memory_bytes=record.peak_gpu_memory_bytes,
    )


def track(command: Sequence[str], *, interval: float = INTERVAL) -> Track:
    """Run a program with its arguments, without a shell, and return its time and memory.

    The program inherits the standard streams, and receives the signals sent to this process. `interval` is
    the time between two measurements of memory in seconds.
    """
    need_extra("bench", "psutil", what="tracking a command")
    gpus = Gpus()
    started, start = datetime.now(UTC), time.perf_counter()
    with _forward_signals() as begin:
        try:
            child = subprocess.Popen(list(command))
        except FileNotFoundError as error:
            raise InputError("FILE_NOT_FOUND", "the program does not exist", file=command[0]) from error
        except OSError as error:
            text = f"the program cannot be started: {error.strerror}"
            raise InputError("FILE_UNREADABLE", text, file=command[0]) from error
        begin(child)
        monitor = _MemoryMonitor(child.pid, gpus, interval)
        monitor.start()
        status = child.wait()
    seconds = time.perf_counter() - start
    monitor.stop()
    peak, source, reason = gpus.result()
    return Track(
        # Replace invalid bytes in arguments, because JSON needs valid text.
        command=tuple(word.encode(errors="backslashreplace").decode() for word in command),
        started=started.isoformat(timespec="seconds"),
        ended=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=seconds,
        exit_status=status if status >= 0 else 128 - status,
        peak_gpu_memory_bytes=peak,
        gpu_source=source,
        gpu_reason=reason,
        gpus=gpus.devices(),
        peak_host_memory_bytes=monitor.peak or None,
        interval_seconds=interval,
        machine={"system": platform.platform(), "cores": os.cpu_count(), "host": platform.node()},
        tool_version=__version__,
    )


class _MemoryMonitor(threading.Thread):
    """Measures the memory of a process and its children until `stop` is called."""

    def __init__(self, pid: int, gpus: Gpus, interval: float) -> None:
        super().__init__(daemon=True)
        self._pid, self._gpus, self._interval = pid, gpus, interval
        self._done = threading.Event()
        self.peak = 0

    def run(self) -> None:
        """Measure the memory once per interval."""
        while True:
            self._gpus.look(self._measure_host())
            if self._done.wait(self._interval):
                return

    def stop(self) -> None:
        """End the measurements."""
        self._done.set()
        self.join()

    def _measure_host(self) -> set[int]:
        """Update the peak of RAM, and return the process numbers."""
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
def _forward_signals() -> Iterator[Callable[[subprocess.Popen[bytes]], None]]:
    """Forward signals to a child process. Pass the child process to the yielded function.

    If a signal arrives before the child process is known, it is forwarded later. If this process ignores a
    signal, for example under nohup, the child process ignores it too.
    """
    children: list[subprocess.Popen[bytes]] = []
    early: list[int] = []

    def send(number: int) -> None:
        with contextlib.suppress(OSError, ValueError):  # Windows supports only a few signals
            children[0].send_signal(number)

    def forward(number: int, _frame: object) -> None:
        if not children:
            early.append(number)
        # Ctrl-C in a terminal reaches all processes of the foreground group, including the child process.
        elif number != signal.SIGINT or not _is_in_foreground():
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


def _is_in_foreground() -> bool:
    """Return whether this process is in the foreground group of its terminal.

    On Windows, an interrupt reaches all processes of a console.
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
