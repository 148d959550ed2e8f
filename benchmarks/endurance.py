"""Search for leaks: one process repeats the same work many times.

    python -m benchmarks.endurance                    all kinds of work in TIMES python -m
    benchmarks.endurance renders trials     these kinds only; --share 0.1 for a tenth of the repetitions

Each kind of work runs in a fresh process. It prints a line after a tenth, after half, and after all of its
repetitions. The line shows the private memory of the process and of its children. The value is the median
since the previous line. It also shows the numbers of open files, threads, children and temporary files. The
first tenth includes everything that is created once: compiled programs, imported libraries, memory pools.
Growth between half and the end indicates a leak.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median
from typing import IO, TYPE_CHECKING, Any

import psutil

import msb
from benchmarks.measure import keep, machine
from msb.registry import METHODS
from msb.scenes.around import make_turntable
from tests.tiny import MODELS, TINY

if TYPE_CHECKING:
    from msb.bench.progress import Stage

TIMES = {"renders": 500, "threads": 4000, "cells": 532, "trials": 50, "bakes": 500}
"""The number of repetitions of each kind of work.

"threads" counts the images that one renderer draws for eight threads. Bakes also use eight threads.
"""
_CELLS = 76
"""Number of cells with a result in the protocol of the tests' tiny scenes."""
_VIEW = 320, 240
_TASKS = "uv", "decimate_50", "subdivide", "boolean", "self_intersections"


class Looks:
    """Count repetitions, and print the resources of the process after a tenth, half and all of them."""

    def __init__(self, kind: str, times: int, rows: IO[str] | None = None) -> None:
        self.kind, self.done, self.start = kind, 0, time.perf_counter()
        self.rows = rows
        self.next = sorted({max(1, times // 10), times // 2, times})
        self.theirs: list[float] = []

    def add(self, count: int = 1) -> None:
        """Add `count` repetitions."""
        self.done += count
        self.theirs.append(held(psutil.Process().children(recursive=True)))
        while self.next and self.next[0] <= self.done:
            self.next.pop(0)
            row = self.row()
            print(line(row), flush=True)
            if self.rows:
                print(json.dumps(row), file=self.rows, flush=True)
            self.theirs.clear()

    def row(self) -> dict[str, Any]:
        """Return the resources that the process holds now."""
        gc.collect()
        seconds, process = time.perf_counter() - self.start, psutil.Process()
        children = process.children(recursive=True)
        own, theirs = held([process]), median(self.theirs)
        temporary = (
            len(list(Path(tempfile.gettempdir()).iterdir())) - 1
        )  # the folder of the work itself does not count
        memory = {"own_mb": round(own, 1), "children_mb": round(theirs, 1)}
        counts = {"files": process.num_fds(), "threads": process.num_threads(), "children": len(children)}
        head = {"kind": self.kind, "times": self.done, "seconds": round(seconds, 1)}
        return {**head, **memory, **counts, "temporary": temporary}


def line(row: dict[str, Any]) -> str:
    """Return a row of the table as text."""
    kind, times, seconds, own, theirs, files, threads, children, temporary = row.values()
    memory = f"{own:8.1f}{theirs:13.1f}{files:7}"
    return f"{kind:8}{times:8,}{seconds:9.1f}{memory}{threads:9}{children:10}{temporary:11}"


def held(processes: list[psutil.Process]) -> float:
    """Return the private memory of these processes in megabytes.

    It excludes shared memory and memory backed by files.
    """
    total = 0.0
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            total += process.memory_full_info().uss / 1e6
    return total


def assets(folder: Path) -> list[Path]:
    """Export the tests' tiny model of every method."""
    found = []
    for model in sorted((MODELS / "walled").iterdir()):
        found.append(folder / f"{model.name}.triasset")
        msb.save(msb.export(model), found[-1])
    return found


def renders(folder: Path, looks: Looks, times: int) -> None:
    """For every method and tier in turn, create a renderer, draw two frames and close it."""
    jobs: list[tuple[Path, Any]] = []
    for path in assets(folder):
        jobs += [(path, tier) for tier in METHODS[path.stem].retained]
    for turn in range(times):
        path, tier = jobs[turn % len(jobs)]
        with msb.Renderer(path, tier=tier) as renderer:
            for camera in make_turntable(msb.load(path), 2, *_VIEW):
                renderer.render(camera)
        looks.add()


def threads(folder: Path, looks: Looks, times: int) -> None:
    """Draw with one renderer from eight threads.

    Compare each image with an image drawn by a single thread.
    """
    path = next(path for path in assets(folder) if path.stem == "triangle_splatting")
    cameras = list(make_turntable(msb.load(path), 8, *_VIEW))
    with msb.Renderer(path, tier="dedicated") as renderer, ThreadPoolExecutor(8) as pool:

        def drawn(camera: msb.Camera) -> str:
            return hashlib.sha256(renderer.render(camera).image.tobytes()).hexdigest()

        alone = [drawn(camera) for camera in cameras]
        for _ in range(0, times, len(cameras)):
            if list(pool.map(drawn, cameras)) != alone:
                raise SystemExit("threads: an image differs from the single-threaded one")
            looks.add(len(cameras))


class _Counted:
    """Progress callback of a run that counts finished cells."""

    def __init__(self, looks: Looks) -> None:
        self.looks = looks

    @contextlib.contextmanager
    def stage(self, stage: Stage) -> Iterator[Callable[[str], None]]:
        yield (lambda _name: self.looks.add()) if stage.title == "cells" else lambda _name: None

    def note(self, _text: str) -> None:
        return


def cells(folder: Path, looks: Looks, times: int) -> None:
    """Run the protocol of the tests' tiny scenes.

    Each repetition is a separate label of a model, so one run contains all of them.
    """
    from msb.bench.protocol import read_protocol
    from msb.bench.run import run_protocol

    for name in ("scenes", "models"):
        (folder / name).symlink_to(TINY / name)
    head, *blocks = (TINY / "protocol.toml").read_text(encoding="utf-8").split("[[methods]]\n")
    for number in range(max(1, times // _CELLS)):
        for at, block in enumerate(blocks):
            head += f'[[methods]]\nlabel = "model {number}-{at}"\n{block}\n'
    file = folder / "protocol.toml"
    file.write_text(head, encoding="utf-8")
    report = run_protocol(read_protocol(file), watch=_Counted(looks))
    if bad := [row.planned.cell for row in report.rows if row.reasons]:
        raise SystemExit(f"cells: {bad[0]} has no result")


def trials(folder: Path, looks: Looks, times: int) -> None:
    """Run the quick trials on one mesh, and compare the outcomes."""
    from msb.trial.run import try_asset

    asset = msb.load(next(path for path in assets(folder) if path.stem == "mesh_splatting"))
    first = None
    for _ in range(times):
        outcomes = json.dumps([(one.task, one.outcome) for one in try_asset(asset, _TASKS).trials])
        first = first or outcomes
        if outcomes != first:
            raise SystemExit(f"trials: {outcomes} after {first}")
        looks.add()


def bakes(folder: Path, looks: Looks, times: int) -> None:
    """Bake every method with `geometry="kept"` in eight threads, and compare the bytes."""
    paths = assets(folder)
    cameras = {path: list(make_turntable(msb.load(path), 2, 32, 24)) for path in paths}

    def baked(turn: int) -> str:
        path, out = paths[turn % len(paths)], folder / f"{turn}.glb"
        msb.bake(path, cameras=cameras[path], geometry="kept").save(out)
        digest = hashlib.sha256(out.read_bytes()).hexdigest()
        out.unlink()
        return digest

    alone = [baked(turn) for turn in range(len(paths))]
    with ThreadPoolExecutor(8) as pool:
        for turn, digest in enumerate(pool.map(baked, range(times))):
            if digest != alone[turn % len(paths)]:
                raise SystemExit(
                    f"bakes: {paths[turn % len(paths)].stem} differs from the single-threaded bake"
                )
            looks.add()


KINDS: dict[str, Callable[[Path, Looks, int], None]] = {
    "renders": renders,
    "threads": threads,
    "cells": cells,
    "trials": trials,
    "bakes": bakes,
}


def main() -> int:
    """Run each kind of work in a fresh process. Return 1 if any of them fails or leaves a file behind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(TIMES)}; default: all")
    parser.add_argument("--share", type=float, default=1.0, help="share of the repetitions; default: 1")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", choices=TIMES, help=argparse.SUPPRESS)
    parser.add_argument("--rows", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if unknown := sorted({*chosen.kinds} - {*TIMES}):
        parser.error(f"{', '.join(unknown)}: there are {', '.join(TIMES)}")
    if kind := chosen.worker:
        times = max(2, round(TIMES[kind] * chosen.share))
        with tempfile.TemporaryDirectory() as folder, chosen.rows.open("a") as rows:
            KINDS[kind](Path(folder), Looks(kind, times, rows), times)
        return 0
    facts = machine("numpy", "pyopencl")
    print("\n".join(f"{name}: {value}" for name, value in facts.items()))
    print("\nkind       times  seconds  own MB  children MB  files  threads  children  temporary")
    failed, found = False, []
    for kind in chosen.kinds or TIMES:
        with tempfile.TemporaryDirectory() as folder, tempfile.NamedTemporaryFile("r") as rows:
            command = [sys.executable, "-m", "benchmarks.endurance", "--worker", kind]
            command += ["--share", str(chosen.share), "--rows", rows.name]
            done = subprocess.run(command, env={**os.environ, "TMPDIR": folder}, check=False)
            if left := sorted(path.name for path in Path(folder).iterdir()):
                print(f"{kind}: left behind at the end: {', '.join(left)}")
            failed |= bool(done.returncode or left)
            found += [json.loads(row) for row in rows]
    keep({"machine": facts, "rows": found}, chosen.json)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
