"""Compare the export of a large checkpoint with a plain copy of its bytes.

    python -m benchmarks.export                  5 million triangles of SH degree 3, three rounds
    python -m benchmarks.export --triangles 1000000 --folder /path/with/room

Every measurement is a fresh process. The copy reads and writes the checkpoint piece by piece. The export
consists of `msb.export` and `msb.save`. Both write a new file and flush it to the disk. Before its time
starts, each writes and removes a file of the same size. Without this, memory that a virtual machine has given
back to its host would make writing three times as slow. Both take turns, so that changes of the machine's
speed affect both equally. The hashes of the source and of every buffer are timed separately. Memory is the
peak of the process, including the mapped checkpoint.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import keep, machine, peak

_PIECE = 1 << 24


def write_checkpoint(path: Path, triangles: int) -> None:
    """Write a Triangle-Splatting checkpoint of random triangles. The values do not matter here."""
    from data_stubs.torch_file import write_torch

    random = np.random.default_rng(0)
    width = {"triangles_points": (3, 3), "sigma": (1,), "features_dc": (1, 3), "features_rest": (15, 3)}
    width["opacity"] = (1,)
    values: dict[str, Any] = {"active_sh_degree": 3}
    for key, shape in width.items():
        values[key] = random.standard_normal((triangles, *shape), np.float32)
    write_torch(path, values)


def prepare(target: Path, size: int) -> None:
    """Remove `target`, and request the memory for writing `size` bytes from the system."""
    target.unlink(missing_ok=True)
    with target.with_name("prepare.bin").open("wb") as file:
        for _ in range(-(-size // _PIECE)):
            file.write(bytes(_PIECE))
    target.with_name("prepare.bin").unlink()


def copy(source: Path, target: Path) -> dict[str, float]:
    """Copy the bytes."""
    prepare(target, source.stat().st_size)
    start = time.perf_counter()
    with source.open("rb") as reader, target.open("wb") as writer:
        while piece := reader.read(_PIECE):
            writer.write(piece)
        writer.flush()
        os.fsync(writer.fileno())
    return {
        "seconds": time.perf_counter() - start,
        "hashing": 0.0,
        "peak": peak(),
        "size": target.stat().st_size,
    }


def export(source: Path, target: Path) -> dict[str, float]:
    """Export and save."""
    import msb

    start = time.perf_counter()
    hashing, last = 0.0, start

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal hashing, last
        now = time.perf_counter()
        if stage.startswith("hashing") and done > _PIECE:
            hashing += now - last
        last = now

    asset = msb.export(source, progress=progress)
    seconds = time.perf_counter() - start
    prepare(target, source.stat().st_size)
    start = time.perf_counter()
    msb.save(asset, target, overwrite=True)
    seconds += time.perf_counter() - start
    return {"seconds": seconds, "hashing": hashing, "peak": peak(), "size": target.stat().st_size}


TASKS = {"copy": copy, "export": export}


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--triangles", type=int, default=5_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where 2.5 GB fit; a temporary folder if not given")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", choices=list(TASKS), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        source, target = options.folder / "point_cloud_state_dict.pt", options.folder / "out.triasset"
        print(json.dumps(TASKS[options.worker](source, target)))
        return
    record: dict[str, Any] = {"machine": machine("numpy"), "triangles": options.triangles}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        write_checkpoint(Path(name) / "point_cloud_state_dict.pt", options.triangles)
        rounds = [{task: run(task, Path(name)) for task in TASKS} for _ in range(options.rounds)]
    record["rounds"] = rounds
    print_table(rounds, options.triangles)
    keep(record, options.json)


def run(task: str, folder: Path) -> dict[str, float]:
    """Run `task` in a separate process, and return its measurements."""
    command = [sys.executable, "-m", "benchmarks.export", "--worker", task, "--folder", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def print_table(rounds: list[dict[str, dict[str, float]]], triangles: int) -> None:
    """Print medians, and the two ratios that have limits for the export."""
    asset = rounds[0]["export"]["size"]
    print(f"\n{triangles:,} triangles of SH degree 3, asset {asset:,.0f} bytes; median of {len(rounds)}")
    print(f"{'task':<10}{'seconds':>9}{'hashing':>9}{'rest / copy':>13}{'peak / asset':>14}")
    for task in TASKS:
        seconds, hashing, high = (
            statistics.median(r[task][key] for r in rounds) for key in ("seconds", "hashing", "peak")
        )
        ratio = statistics.median(
            (r[task]["seconds"] - r[task]["hashing"]) / r["copy"]["seconds"] for r in rounds
        )
        print(f"{task:<10}{seconds:>9.2f}{hashing:>9.2f}{ratio:>13.2f}{high / asset:>14.2f}")


if __name__ == "__main__":
    main()
