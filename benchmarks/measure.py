"""Helpers of all benchmarks.

They describe the machine, measure peak memory and CPU time, and write results as JSON.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import platform
import re
import resource
import shutil
import subprocess
import tempfile
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil


def machine(*packages: str) -> dict[str, str]:
    """Return a description of the machine, and the versions of `packages`."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    from msb import __version__

    versions = {"meshsplatbench": __version__}
    for name in packages:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    cores = f"{len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()} cores"
    return {"machine": f"{model}, {cores}", "python": platform.python_version(), **versions}


def keep(record: dict[str, Any], path: Path | None) -> None:
    """Write measurements to `path` as JSON; do nothing if `path` is None."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=1) + "\n")


def c_library(source: Path, *flags: str) -> ctypes.CDLL:
    """Compile C source with OpenMP, -O3 and `flags`, and return the library.

    Idle OpenMP threads sleep. By default its threads would stay busy for milliseconds after their work, and
    slow the next measurement.

    Raises
    ------
    RuntimeError
        A C compiler is missing, or it rejects the source.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise RuntimeError("no C compiler found; set the environment variable CC")
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "peer.so")
        command = [
            compiler,
            "-O3",
            "-fopenmp",
            "-shared",
            "-fPIC",
            *flags,
            "-o",
            str(library),
            str(source),
            "-lm",
        ]
        try:
            subprocess.run(command, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise RuntimeError(f"{source.name} cannot be compiled: {error}") from error
        return ctypes.CDLL(str(library))


def reset_peak() -> int:
    """Reset the peak memory of the process to its current use, if the system allows this.

    Return the peak memory in bytes.
    """
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return peak()


def peak() -> int:
    """Return the peak memory of the process in bytes.

    /proc is preferred to getrusage. With getrusage, a child starts with the peak of its parent.
    """
    return _peak("self") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def peak_with_children() -> int:
    """Return the sum of the peaks of this process and its children. Shared pages count several times."""
    found = peak()
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(OSError):
            found += _peak(str(child.pid))
    return found


def processor_seconds() -> float:
    """Return the CPU time of this process and its children in seconds."""
    found = time.process_time()
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            found += sum(child.cpu_times()[:2])
    return found


def _peak(process: str) -> int:
    status = Path("/proc") / process / "status"
    return int(re.search(r"VmHWM:\s*(\d+) kB", status.read_text())[1]) * 1024 if status.exists() else 0
