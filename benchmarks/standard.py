"""Compare frame times of the standard tier and of other opaque renderers, on the same arrays in one run.

    python -m benchmarks.standard                              all scenes, all installed peers
    python -m benchmarks.standard --scenes shell-1M --rounds 30 --tools msb vtk

A frame clears the buffers, draws, and reads the image back to the host. Nothing is uploaded, and the camera
does not move. Each tool runs in its own process, prepares once, and draws on request. Tools take turns within
a round, so that changes of the machine's speed affect all tools equally. The table shows medians over rounds,
and the median of the ratios to our time within a round. Images are compared with ours. CPU time and peak
memory include child processes (a browser, Blender). Shared pages count several times.
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

from benchmarks.measure import keep, machine, peak_with_children, processor_seconds
from benchmarks.standard_peers import PEERS
from benchmarks.standard_scenes import HEIGHT, SCENES, WIDTH, Scene

THREADS = ("POCL_MAX_PTHREAD_COUNT", "OMP_NUM_THREADS", "LP_NUM_THREADS")
"""Environment variables that limit the threads of PoCL, OpenMP and Mesa's software renderers."""
PACKAGES = (
    *("numpy", "pyopencl", "pocl-binary-distribution", "vtk", "pyvista", "moderngl", "wgpu", "open3d"),
    "embreex",
)
LEVEL = 1.01 / 255


class Tool:
    """A renderer in a separate process."""

    def __init__(self, name: str, folder: Path, threads: int | None) -> None:
        limit = {} if threads is None else dict.fromkeys(THREADS, str(threads))
        command = [sys.executable, "-m", "benchmarks.standard", "--worker", name, "--folder", str(folder)]
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed with the process
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, **limit},
        )

    def ask(self, word: str) -> dict[str, Any]:
        """Return the worker's answer. If the worker has ended, raise an error with its last output."""
        try:
            self._process.stdin.write(word + "\n")
            self._process.stdin.flush()
            for line in self._process.stdout:
                if line.startswith("{"):  # libraries may print too
                    return json.loads(line)
        except BrokenPipeError:
            pass
        self._log.seek(0)
        words = [line for line in self._log.read().strip().splitlines() if line.strip()]
        raise RuntimeError(words[-1] if words else f"status {self._process.wait()}")

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait(timeout=60)
        self._log.close()


def work(name: str, folder: Path) -> None:
    """Prepare the renderer. Then draw a frame for every line of standard input, and print its time."""
    arrays = (np.load(folder / f"{part}.npy") for part in ("positions", "indices", "colors"))
    scene = Scene(*arrays, shared=(folder / "shared").exists())
    start = time.perf_counter()
    frame = PEERS[name][1](scene)
    image = frame()
    prepared = time.perf_counter() - start
    for _ in range(2):
        image = frame()
    for line in sys.stdin:
        if line.strip() == "prepared":
            if image is not None:
                np.save(folder / f"{name}.npy", image)
            answer = {"seconds": prepared, "bytes": peak_with_children(), **getattr(frame, "about", {})}
        else:
            busy, start = processor_seconds(), time.perf_counter()
            frame()
            milliseconds = 1e3 * (time.perf_counter() - start)
            answer = {"ms": milliseconds, "cpu_ms": 1e3 * (processor_seconds() - busy)}
        print(json.dumps(answer), flush=True)


def compare(tools: list[str], scene: Scene, rounds: int, threads: int | None) -> list[dict[str, Any]]:
    """Return a row for each tool."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("positions", "indices", "colors"):
            np.save(folder / f"{part}.npy", getattr(scene, part))
        if scene.shared:
            (folder / "shared").touch()
        running: dict[str, Tool] = {}
        rows: list[dict[str, Any]] = []
        for tool in tools:
            worker = Tool(tool, folder, threads)
            try:
                rows.append({"tool": tool, "prepared": worker.ask("prepared"), "frames": []})
                running[tool] = worker
            except RuntimeError as error:
                rows.append({"tool": tool, "error": str(error)})
        for _ in range(rounds):
            for row in rows:
                if row["tool"] in running:
                    row["frames"].append(running[row["tool"]].ask("frame"))
        for worker in running.values():
            worker.close()
        ours = next((row for row in rows if row["tool"] == tools[0]), rows[0])
        for row in rows:
            if "error" not in row:
                _summarise(row, ours, folder)
    return rows


def _summarise(row: dict[str, Any], ours: dict[str, Any], folder: Path) -> None:
    row["ms"] = statistics.median(frame["ms"] for frame in row["frames"])
    row["cpu_ms"] = statistics.median(frame["cpu_ms"] for frame in row["frames"])
    if "frames" in ours:
        pairs = zip(row["frames"], ours["frames"], strict=True)
        row["ratio"] = statistics.median(theirs["ms"] / own["ms"] for theirs, own in pairs)
    images = [folder / f"{tool}.npy" for tool in (row["tool"], ours["tool"])]
    if all(image.exists() for image in images):
        theirs, own = (_unit(np.load(image)) for image in images)
        row["within_a_level"] = float((np.abs(theirs - own).max(axis=2) <= LEVEL).mean())


def _unit(image: np.ndarray) -> np.ndarray:
    if image.dtype == np.uint8:
        return image / np.float32(255)
    return np.round(np.clip(image, 0, 1) * 255) / np.float32(255)


def print_table(title: str, rows: list[dict[str, Any]]) -> None:
    """Print the rows of one scene."""
    print(f"\n{title}")
    print(f"{'tool':<18}{'ms':>8}{'/ ours':>8}{'CPU ms':>8}{'s first':>9}{'MB':>7}{'equal %':>9}  what it is")
    for row in rows:
        if "error" in row:
            print(f"{row['tool']:<18}  not run: {row['error'][:120]}")
            continue
        equal = f"{100 * row['within_a_level']:.2f}" if "within_a_level" in row else "-"
        ready = row["prepared"]
        print(
            f"{row['tool']:<18}{row['ms']:>8.1f}{row.get('ratio', float('nan')):>8.2f}{row['cpu_ms']:>8.1f}"
            f"{ready['seconds']:>9.2f}{ready['bytes'] / 1e6:>7.0f}{equal:>9}  {PEERS[row['tool']][0]}"
        )


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--tools", nargs="+", choices=list(PEERS), default=list(PEERS))
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, help="threads of every tool that can be limited; default: all")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", choices=list(PEERS), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(options.worker, options.folder)
        return
    tools = ["msb", *(tool for tool in options.tools if tool != "msb")]
    record: dict[str, Any] = {"machine": machine(*PACKAGES), "threads": options.threads, "scenes": []}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    print(
        f"threads: {options.threads or 'all'}; {WIDTH} x {HEIGHT} pixels; median of {options.rounds} frames"
    )
    for name in options.scenes:
        what, make = SCENES[name]
        scene = make()
        rows = compare(tools, scene, options.rounds, options.threads)
        for row in rows:
            row["what"] = PEERS[row["tool"]][0]
        found = {"scene": name, "what": what, "faces": len(scene.indices), "rows": rows}
        record["scenes"].append(found)
        print_table(f"{name}: {what}", rows)
        sys.stdout.flush()
    keep(record, options.json)


if __name__ == "__main__":
    main()
