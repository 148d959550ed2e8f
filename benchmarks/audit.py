"""Compare audit speed with libigl, PyMeshLab, trimesh, MeshLib and Open3D, on the same arrays in one run.

    python -m benchmarks.audit                        0.1, 1, 4 and 10 million faces: about twelve minutes
    python -m benchmarks.audit --all                  slow peers at all sizes: about half an hour
    python -m benchmarks.audit --sizes 61 --rounds 5 --parts peers
                                                      about 0.1 million faces, first table only

Each measurement is a fresh process that loads the arrays, warms up on a mesh of 0.1 million faces, and runs
once. Tools take turns within a round, so that changes of the machine's speed affect all tools equally. The
table shows medians. It also shows the ratio of a peer's time to our time in the same round. Slow tools run in
the first round only. Without --all, slow tools skip the largest sizes. Memory is the growth of the peak
memory of the process, after arrays and libraries were loaded. Peers that are not installed are skipped.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.audit_meshes import HOSTILE, hostile
from benchmarks.audit_tools import AT_MOST, ONCE_FROM, PACKAGES, TOOLS, WHAT
from benchmarks.measure import keep, machine, peak, reset_peak

if TYPE_CHECKING:
    Result = dict[str, Any]

SIZES = (61, 194, 388, 614)
"""Lattice sizes of the generator: about 0.1, 1, 4 and 10 million faces."""
WARM = 61
MAIN = 388
"""Lattice size for threads, first calls, whole processes and hostile meshes."""
FACES_PER_SQUARE = 26.6
"""Number of faces of the generated mesh, divided by the square of the lattice size."""
PARTS = ("peers", "threads", "first", "process", "hostile")


# ---- one measurement


def measure(tool: str, folder: Path, warm: bool) -> None:
    """Run one measurement in this process and print it as JSON."""
    vertices, faces = (np.load(folder / f"{name}.npy") for name in ("vertices", "faces"))
    if warm:
        with contextlib.suppress(FileNotFoundError):
            small = (np.load(folder.parent / "warm" / f"{name}.npy") for name in ("vertices", "faces"))
            TOOLS[tool](*small)()
    work = TOOLS[tool](vertices, faces)
    before = reset_peak()
    start = time.perf_counter()
    answers = work()
    seconds = time.perf_counter() - start
    print(json.dumps({"seconds": seconds, "bytes": peak() - before, "answers": answers}))


def run(tool: str, folder: Path, *, warm: bool = True, **env: str) -> Result:
    """Run one measurement in a separate process; return its result or the reason for its failure."""
    command = [sys.executable, "-m", "benchmarks.audit", "--worker", tool, "--folder", str(folder)]
    done = subprocess.run(
        [*command, *([] if warm else ["--cold"])], capture_output=True, text=True, env={**os.environ, **env}
    )
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        ended = f"ended by signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
        return {"error": (done.stderr.strip().splitlines() or [ended])[-1]}
    return dict(json.loads(lines[-1]))


@contextlib.contextmanager
def stored(root: Path, name: str, mesh: tuple[NDArray[Any], NDArray[Any]]) -> Iterator[Path]:
    """Keep a mesh's arrays in a folder of `root` while the block runs."""
    with tempfile.TemporaryDirectory(dir=root, prefix=name) as folder:
        for key, array in zip(("vertices", "faces"), mesh, strict=True):
            np.save(Path(folder) / f"{key}.npy", array)
        del mesh
        yield Path(folder)


def middle(results: list[Result], key: str = "seconds") -> float:
    """Return the median over the results with this key, or NaN without such results."""
    values = [result[key] for result in results if key in result]
    return statistics.median(values) if values else math.nan


# ---- against the peers


def peers(folder: Path, faces: int, tools: list[str], rounds: int, everything: bool) -> list[Result]:
    """Return a row per tool: medians over rounds, ratios within rounds, and answers that differ from ours."""
    found: dict[str, list[Result]] = {tool: [] for tool in tools}
    for number in range(rounds):
        for tool in tools:
            late = number > 0 and faces >= ONCE_FROM.get(tool, math.inf)
            if late or (faces > AT_MOST.get(tool, math.inf) and not everything):
                found[tool].append({})
            else:
                found[tool].append(run(tool, folder))
    ours, rows = found["msb"], []
    for tool, results in found.items():
        good = [result for result in results if "seconds" in result]
        if not good:
            reasons = [result["error"] for result in results if "error" in result]
            rows.append({"tool": tool, "error": reasons[0] if reasons else "not at this size without --all"})
            continue
        answers = {k: [v, ours[0]["answers"].get(k, v)] for k, v in good[0]["answers"].items()}
        pairs = [(own, their) for own, their in zip(ours, results, strict=True) if "seconds" in their]
        rows.append(
            {
                "tool": tool,
                "seconds": middle(good),
                "ratio": statistics.median(their["seconds"] / own["seconds"] for own, their in pairs),
                "bytes_per_face": middle(good, "bytes") / faces,
                "differs": {key: both for key, both in answers.items() if both[0] != both[1]},
                "rounds": good,
            }
        )
    return rows


def print_peers(faces: int, rounds: int, rows: list[Result]) -> None:
    """Print the rows of one mesh size."""
    print(f"\n{faces:,} faces, shuffled; median of {rounds}, or one")
    print(f"{'tool':<16}{'seconds':>9}{'/ ours':>8}{'B/face':>8}  what it does")
    for row in rows:
        if "error" in row:
            print(f"{row['tool']:<16}  {row['error']}")
            continue
        print(
            f"{row['tool']:<16}{row['seconds']:>9.3f}{row['ratio']:>8.2f}{row['bytes_per_face']:>8.0f}"
            f"  {WHAT[row['tool']]}"
        )
        for key, (theirs, own) in row["differs"].items():
            print(f"{'':<16}  DIFFERS: {key} is {theirs}, ours {own}")
    sys.stdout.flush()


def growth(sizes: list[Result]) -> dict[str, float]:
    """Return for each tool the exponent e of the best fit of seconds ~ faces^e."""
    times: dict[str, list[tuple[float, float]]] = {}
    for size in sizes:
        for row in size["rows"]:
            if "seconds" in row:
                times.setdefault(row["tool"], []).append((size["faces"], row["seconds"]))
    logs = {tool: np.log(points) for tool, points in times.items() if len(points) > 1}
    return {tool: float(np.polyfit(x[:, 0], x[:, 1], 1)[0]) for tool, x in logs.items()}


# ---- our own


def threads(folder: Path, rounds: int) -> Result:
    """Return the seconds with one thread and with all threads, measured in turns."""
    one, every = [], []
    for _ in range(rounds):
        one.append(run("msb", folder, POCL_MAX_PTHREAD_COUNT="1"))
        every.append(run("msb", folder))
    pairs = zip(one, every, strict=True)
    gain = statistics.median(a["seconds"] / b["seconds"] for a, b in pairs)
    return {"one": middle(one), "all": middle(every), "gain": gain}


def first_calls(folder: Path, rounds: int) -> Result:
    """Return the seconds of three calls.

    These are a second call, the first call of a process, and a first call with an empty cache.
    """
    second, first, ever = [], [], []
    for _ in range(rounds):
        second.append(run("msb", folder))
        first.append(run("msb", folder, warm=False))
        with tempfile.TemporaryDirectory() as cache:
            ever.append(run("msb", folder, warm=False, POCL_CACHE_DIR=cache))
    return {"second call": middle(second), "first in a process": middle(first), "first ever": middle(ever)}


def processes(folder: Path, rounds: int) -> Result:
    """Return the seconds that msb-audit needs for a file, from its start until its table is printed."""
    from msb.asset import write_asset
    from msb.meshes import Mesh, write_mesh
    from msb.meshes.assets import asset_from_mesh

    mesh = Mesh(np.load(folder / "vertices.npy"), np.load(folder / "faces.npy").astype(np.int64))
    write_asset(asset_from_mesh(mesh), folder / "mesh.triasset")
    for suffix in (".ply", ".glb"):
        write_mesh(mesh, folder / f"mesh{suffix}", suffix=suffix)
    del mesh
    times: dict[str, list[float]] = {}
    for _ in range(rounds):
        for suffix, cache in ((".triasset", None), (".ply", None), (".glb", None), (".triasset", "empty")):
            with tempfile.TemporaryDirectory() as empty:
                env = {**os.environ, **({"POCL_CACHE_DIR": empty} if cache else {})}
                command = [sys.executable, "-m", "msb", "audit", str(folder / f"mesh{suffix}")]
                start = time.perf_counter()
                subprocess.run(command, check=True, capture_output=True, env=env)
                name = f"{suffix}, first ever" if cache else suffix
                times.setdefault(name, []).append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def hostiles(root: Path, counts: tuple[int, ...]) -> list[Result]:
    """Return a row for each hostile mesh.

    A row has seconds and memory at each number of faces, and the growth of both.
    """
    rows = []
    for name in HOSTILE:
        row: Result = {"mesh": name, "what": (HOSTILE[name].__doc__ or "").rstrip("."), "at": {}}
        for count in counts if name == "soup" else counts[:2]:
            with stored(root, name, hostile(name, count)) as folder:
                row["at"][count] = run("msb", folder)
        times = {count: result["seconds"] for count, result in row["at"].items() if "seconds" in result}
        if len(times) > 1:
            ends = (min(times), max(times))
            row["growth"] = math.log(times[ends[1]] / times[ends[0]]) / math.log(ends[1] / ends[0])
        rows.append(row)
    return rows


def print_hostiles(rows: list[Result]) -> None:
    """Print the rows."""
    print(f"\nHostile meshes, ours\n{'mesh':<16}{'faces':>12}{'seconds':>9}{'B/face':>8}{'growth':>8}")
    for row in rows:
        for count, result in row["at"].items():
            if "error" in result:
                print(f"{row['mesh']:<16}{count:>12,}  failed: {result['error']}")
                continue
            last = f"{row['growth']:>8.2f}  {row['what']}" if count == max(row["at"]) else ""
            print(
                f"{row['mesh']:<16}{count:>12,}{result['seconds']:>9.3f}{result['bytes'] / count:>8.0f}{last}"
            )


# ---- all of it


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="lattice sizes (n)")
    parser.add_argument("--main", type=int, default=MAIN, help="lattice size of all parts except the peers")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--tools", nargs="+", choices=list(TOOLS), default=list(TOOLS))
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--all", action="store_true", help="run slow peers at every size")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", choices=list(TOOLS), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cold", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        measure(options.worker, options.folder, not options.cold)
        return
    record: Result = {"machine": machine(*PACKAGES), "what": WHAT, "sizes": []}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    with tempfile.TemporaryDirectory() as name:
        measure_all(Path(name), options, record)
    keep(record, options.json)


def measure_all(root: Path, options: argparse.Namespace, record: Result) -> None:
    """Run the chosen parts, print each as it finishes, and add it to `record`."""
    from data_stubs.splat_like import splat_like

    (root / "warm").mkdir()
    for key, array in zip(("vertices", "faces"), splat_like(WARM), strict=True):
        np.save(root / "warm" / f"{key}.npy", array)
    tools = ["msb", *(tool for tool in options.tools if tool != "msb")]
    for n in options.sizes if "peers" in options.parts else ():
        with stored(root, "mesh", splat_like(n)) as folder:
            faces = len(np.load(folder / "faces.npy", mmap_mode="r"))
            rows = peers(folder, faces, tools, options.rounds, options.all)
        record["sizes"].append({"n": n, "faces": faces, "rows": rows})
        print_peers(faces, options.rounds, rows)
    if len(record["sizes"]) > 1:
        record["growth"] = growth(record["sizes"])
        fits = ", ".join(f"{tool} {power:.2f}" for tool, power in record["growth"].items())
        print(f"\nSeconds grow with the number of faces to the power of: {fits}")
    own = {"threads": threads, "first": first_calls, "process": processes}
    if set(own) & set(options.parts):
        with stored(root, "mesh", splat_like(options.main)) as folder:
            for part in (part for part in own if part in options.parts):
                record[part] = own[part](folder, options.rounds)
                figures = ", ".join(f"{name} {value:.2f}" for name, value in record[part].items())
                print(f"\nOurs at n = {options.main}, {part}: {figures}", flush=True)
    if "hostile" in options.parts:
        faces = round(FACES_PER_SQUARE * options.main**2)
        record["hostile"] = hostiles(root, (faces // 4, faces, faces * 5 // 2))
        print_hostiles(record["hostile"])


if __name__ == "__main__":
    main()
