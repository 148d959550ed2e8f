"""What commands take at the sizes that are trained: seconds, peak of memory, and what bounds each.

    python -m benchmarks.sizes                       1 and 4 million faces of MeshSplatting
    python -m benchmarks.sizes --faces 100000 --command why --command info --folder /path/with/room

Every command runs in a process of its own, on a mesh with shared vertices and SH degree 3; all but `export`
and `import` take the asset that `export` wrote. `import` is the empty command, what every other one starts
with. Seconds are those of the clock; `processor` is that of all threads and children, which a busy machine
changes less. Memory is the higher peak of the process, mapped files included, and of the largest child. What
bounds a command is where its main thread was, by a profile of that run, which costs a few per cent of it.
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
"""What a function is counted as, by part of its name or place, the first that fits; all else is Python. Lines
of ours that take long are arithmetic on arrays."""
_SHOWN = 0.1
"""The least share of the time that is named."""

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
"""Command -> its arguments, about the asset in a folder."""


def measure(arguments: list[str]) -> dict[str, Any]:
    """Run a command in this process, and return what it took."""
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
    """Return kind of work -> its share of the time, the largest first."""
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
    parser.add_argument("--rounds", type=int, default=1, help="medians of so many are printed")
    parser.add_argument("--folder", type=Path, help="where 2 GB fit; a temporary folder if not given")
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
    """Run every command at every size, and print a row of each."""
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
    """Return what a process of its own found about `command`."""
    line = [sys.executable, "-m", "benchmarks.sizes", "--worker", command, "--folder", f"{folder}"]
    subprocess.run([*line, "--faces", f"{faces}"], stdout=subprocess.DEVNULL, check=True)
    found: dict[str, Any] = {} if command == "write" else json.loads((folder / "found.json").read_text())
    return found


if __name__ == "__main__":
    main()
