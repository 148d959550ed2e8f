"""Compare the time and memory of commands between this working tree and another commit.

Both take turns in one run.

    python -m benchmarks.before 7cad086                         a million faces, medians of three rounds
    python -m benchmarks.before HEAD~1 --faces 100000 --rounds 5 --row audit --row dedicated/diffsoup

Each row is a command. It runs first with the package of the other commit, and then with this working tree.
Both read the same checkpoint. If the command needs an asset, each package first exports the asset from this
checkpoint. The columns are wall time, CPU time of all threads (seconds) and peak memory (GB). Rows of `msb
bench` show the median time of a frame of 1237 x 822 pixels, in milliseconds. The last column is the ratio of
the times: now divided by before. Both use the same environment and libraries.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.dedicated_scenes import SIZES, camera
from benchmarks.measure import keep, machine

METHODS = "two_dts", "triangle_splatting", "mesh_splatting", "diffsoup"
_MESH = "mesh_splatting"
_ROOT = Path(__file__).resolve().parent.parent
_WRITE = (
    "import sys; from pathlib import Path; from benchmarks.scale import write_checkpoint; "
    "write_checkpoint(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))"
)
_FRAMES = "--repeat", "20", "--seconds", "2", "--cameras", "views.json", "-q", "-f", "--json", "frames.json"

ROWS: dict[str, tuple[str, list[str]]] = {
    "export": (_MESH, ["export", "-q", "-f", ".", "model.triasset"]),
    "info": (_MESH, ["info", "model.triasset"]),
    "validate": (_MESH, ["validate", "model.triasset"]),
    "audit": (_MESH, ["audit", "model.triasset"]),
    "repair": (_MESH, ["repair", "-q", "-f", "model.triasset", "-o", "repaired.triasset"]),
    "page": (_MESH, ["web", "-q", "-f", "--cameras", "views.json", "model.triasset", "-o", "page.html"]),
    "why": (_MESH, ["why", "-q", "--size", "640x480", "model.triasset"]),
    **{
        f"{tier}/{method}": (method, ["bench", "model.triasset", "--tier", tier, *_FRAMES])
        for tier in ("standard", "dedicated")
        for method in METHODS
        if (tier, method) != ("standard", "diffsoup")  # DiffSoup has no static colours
    },
}
"""The rows: the method of the model, and a command that both commits have.

The command runs in the folder of the model.
"""


@dataclass(frozen=True)
class Round:
    """Time and memory of one run of a command. `frame` is in milliseconds and only set for `msb bench`."""

    seconds: float
    processor: float
    peak: float
    frame: float | None


def run(package: Path, folder: Path, arguments: list[str]) -> Round:
    """Run a command of the `msb` in `package`, in the folder of a model."""
    environment = {**os.environ, "PYTHONPATH": str(package), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "msb", *arguments]
    start = time.perf_counter()
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL) as child:
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.perf_counter() - start
    if child.returncode:
        raise SystemExit(f"{package}: msb {' '.join(arguments)} ended with status {child.returncode}")
    frames = folder / "frames.json"
    frame = json.loads(frames.read_text())["device_ms"]["p50"] if "frames.json" in arguments else None
    return Round(seconds, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e9, frame)


def make_model(folder: Path, method: str, faces: int, packages: list[Path]) -> list[Path]:
    """Write a checkpoint and its camera into a folder for each package, and return the folders."""
    width, height = SIZES[0]
    view = camera(width, height)
    size = {key: getattr(view, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    views = [{"name": "scene", **size, "world_to_camera": view.world_to_camera.tolist()}]
    folders = []
    for number, package in enumerate(packages):
        folders.append(folder / f"{method}-{number}")
        folders[-1].mkdir()
        # Use another process, because the peak memory of a child starts with the peak of its parent.
        writing = [sys.executable, "-c", _WRITE, str(folders[-1]), method, str(faces)]
        subprocess.run(writing, cwd=_ROOT, check=True)
        (folders[-1] / "views.json").write_text(json.dumps({"schema": "msb.views/1", "cameras": views}))
        run(package, folders[-1], ROWS["export"][1])
    return folders


def compare(rows: list[str], faces: int, rounds: int, packages: list[Path]) -> dict[str, list[list[Round]]]:
    """Measure all rows, and print a line for each. Return the rounds by row and package."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        models: dict[str, list[Path]] = {}
        for row in rows:
            method, arguments = ROWS[row]
            if method not in models:
                models[method] = make_model(Path(name), method, faces, packages)
            pairs = list(zip(packages, models[method], strict=True))
            taken = [[run(*pair, arguments) for pair in pairs] for _ in range(rounds)]
            found[row] = [list(each) for each in zip(*taken, strict=True)]
            print(line(row, *found[row]), flush=True)
    return found


def line(row: str, before: list[Round], now: list[Round]) -> str:
    """Return the line of a row: medians before and now, and their ratio."""
    if before[0].frame is not None:
        old, new = (statistics.median(each.frame or 0 for each in rounds) for rounds in (before, now))
        texts = [f"{value:>12.1f} ms" + 12 * " " for value in (old, new)]
    else:
        old, new = (statistics.median(each.seconds for each in rounds) for rounds in (before, now))
        texts = [
            "".join(
                f"{statistics.median(getattr(each, key) for each in rounds):>9.2f}"
                for key in ("seconds", "processor", "peak")
            )
            for rounds in (before, now)
        ]
    return f"{row:<32}{texts[0]:<27}   {texts[1]:<27}{new / old:>6.2f}"


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("commit", help="commit to compare with, as git names it")
    parser.add_argument("--faces", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3, help="rounds; medians are printed")
    parser.add_argument("--row", choices=ROWS, action="append", help="default: all")
    parser.add_argument("--json", type=Path, help="also write every round to this file")
    options = parser.parse_args()
    names = machine("numpy", "pyopencl", "pocl-binary-distribution")
    print("\n".join(f"{key}: {value}" for key, value in names.items()))
    print(f"before: {options.commit}; {options.faces:,} faces; medians of {options.rounds}, by turns\n")
    print(f"{'':<32}{'before: s, CPU s, GB':<30}{'now':<27}{'now/before':>6}")
    archive = subprocess.run(
        ["git", "-C", str(_ROOT), "archive", options.commit, "msb"], capture_output=True, check=True
    )
    with tempfile.TemporaryDirectory() as old, tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(old, filter="data")
        found = compare(options.row or list(ROWS), options.faces, options.rounds, [Path(old), _ROOT])
    rounds = {row: [[asdict(each) for each in taken] for taken in pair] for row, pair in found.items()}
    keep({"machine": names, "before": options.commit, "faces": options.faces, "rows": rounds}, options.json)


if __name__ == "__main__":
    main()
