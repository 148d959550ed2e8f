"""Measure commands at real model sizes: seconds, peak memory, and the share of the time of each kind of work.

    python -m benchmarks.sizes                       1 and 4 million faces of MeshSplatting
    python -m benchmarks.sizes --faces 100000 --command why --command info --folder /path/with/room

Each command runs in a separate process, on a mesh with shared vertices and SH degree 3. `export` writes the
asset that the other commands read. `import` only imports the package, like every command. Seconds are wall
time. `processor` is the CPU time of all threads and children; it depends less on other load. Memory is the
peak of the process, or of its largest child if that is higher. It includes mapped files. The shares of time
come from a profile of the main thread. The profile slows the run by a few per cent.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.measure import keep, machine, peak
from benchmarks.scale import write_checkpoint

_ASSET = "sizes.triasset"
_METHOD = "mesh_splatting"
_BOUNDS = (
    ("hashing", ("_hashlib", "_blake2")),
    ("OpenCL", ("pyopencl", "msb/cl/")),
    ("a child", ("time.sleep", "poll", "waitpid")),
    ("sorting", ("sort", "unique", "searchsorted")),
    ("files", ("_io.", "io.open", "posix.", "mmap", "npz", "zipfile", "zlib")),
    ("NumPy", ("numpy", "/msb/")),
)
"""Kinds of work, by a part of the name or file of a function.

The first match counts. Work without a match is counted as "Python". Slow lines of our code are array
arithmetic.
"""
_SHOWN = 0.1
"""Smallest share of the time that is listed."""

COMMANDS: dict[str, Callable[[Path], list[str]]] = {
    "export": lambda folder: ["export", "-q", "-f", f"{folder}", f"{folder / _ASSET}"],
    "import": lambda _: ["--version"],
    "info": lambda folder: ["info", f"{folder / _ASSET}"],
    "validate": lambda folder: ["validate", f"{folder / _ASSET}"],
    "repair": lambda folder: [
        *("repair", "-q", "-f", f"{folder / _ASSET}"),
        *("-o", f"{folder / 'repaired.triasset'}"),
    ],
    "trial solid": lambda folder: ["trial", "-q", "--task", "solid", f"{folder / _ASSET}"],
    "trial intersections": lambda folder: ["trial", "-q", "--task", "intersections", f"{folder / _ASSET}"],
    "why": lambda folder: ["why", "-q", "--size", "640x480", f"{folder / _ASSET}"],
}
"""For each command, a function that takes the folder with the asset and returns the arguments."""


def measure(arguments: list[str]) -> dict[str, Any]:
    """Run a command in this process, and return its time, memory and profile."""
    profile = cProfile.Profile()
    start = time.perf_counter()
    profile.enable()
    from msb.cli.app import app

    try:
        status = app(arguments, standalone_mode=False) or 0
    except SystemExit as ended:
        status = ended.code
    profile.disable()
    seconds = time.perf_counter() - start
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {
        "status": status,
        "seconds": seconds,
        "processor": sum(one.ru_utime + one.ru_stime for one in (own, children)),
        "peak": max(peak(), children.ru_maxrss * 1024),
        "bounds": bounds(profile),
    }


def bounds(profile: cProfile.Profile) -> dict[str, float]:
    """Return the share of the time for each kind of work, the largest first."""
    found: Counter[str] = Counter()
    for (file, _, name), (_, _, own, _, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        place = f"{file} {name}"
        found[next((kind for kind, parts in _BOUNDS if any(map(place.__contains__, parts))), "Python")] += own
    total = sum(found.values())
    return {kind: seconds / total for kind, seconds in found.most_common()}


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--faces", type=int, nargs="+", default=[1_000_000, 4_000_000])
    parser.add_argument("--command", choices=COMMANDS, action="append", help="after export; default: all")
    parser.add_argument("--rounds", type=int, default=1, help="runs per command; the median is printed")
    parser.add_argument("--folder", type=Path, help="folder with 2 GB of space; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", choices=["write", *COMMANDS], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker == "write":
        write_checkpoint(options.folder, _METHOD, options.faces[0])
    elif options.worker:
        found = measure(COMMANDS[options.worker](options.folder))
        (options.folder / "found.json").write_text(json.dumps(found))
    else:
        measure_all(options)


def measure_all(options: argparse.Namespace) -> None:
    """Run every command at every size, and print a row for each."""
    packages = "numpy", "pyopencl", "pocl-binary-distribution"
    record: dict[str, Any] = {"machine": machine(*packages), "sizes": {}}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    heads = f"{'seconds':>8}{'processor':>11}{'peak GB':>9}"
    print(f"\n{'faces':>10}  {'command':<21}{heads}  bound by", flush=True)
    for faces in options.faces:
        rows = record["sizes"][faces] = {}
        with tempfile.TemporaryDirectory(dir=options.folder) as name:
            apart("write", Path(name), faces)
            wanted = ["export", *(options.command or COMMANDS)]
            for command in dict.fromkeys(wanted):
                rounds = [apart(command, Path(name), faces) for _ in range(options.rounds)]
                rows[command] = rounds
                seconds, processor, high = (
                    statistics.median(one[key] for one in rounds) for key in ("seconds", "processor", "peak")
                )
                bound = ", ".join(
                    f"{kind} {100 * share:.0f} %"
                    for kind, share in rounds[0]["bounds"].items()
                    if share >= _SHOWN
                )
                row = f"{seconds:>8.1f}{processor:>11.1f}{high / 1e9:>9.2f}"
                print(f"{faces:>10,}  {command:<21}{row}  {bound}", flush=True)
    keep(record, options.json)


def apart(command: str, folder: Path, faces: int) -> dict[str, Any]:
    """Run `command` in a separate process and return its measurements."""
    line = [sys.executable, "-m", "benchmarks.sizes", "--worker", command, "--folder", f"{folder}"]
    subprocess.run([*line, "--faces", f"{faces}"], stdout=subprocess.DEVNULL, check=True)
    found: dict[str, Any] = {} if command == "write" else json.loads((folder / "found.json").read_text())
    return found


if __name__ == "__main__":
    main()
