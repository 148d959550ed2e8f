"""Compare repair steps with the audit's NumPy twin, libigl and PyMeshLab, on the same mesh in one run.

    python -m benchmarks.repair                       about 0.1 and 1 million faces
    python -m benchmarks.repair --sizes 614           about 10 million faces

Each measurement is a fresh process that loads the arrays and runs once. Loading libigl and PyMeshLab is not
timed. Times are CPU seconds, because a step uses one core and the machine may be shared. The ratio is to the
time of the twin. The twin audits the same mesh with NumPy and SciPy. Tools take turns within a round. The
table shows medians. Memory is the growth of the peak memory of the process, after arrays and libraries were
loaded.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import keep, machine, peak, reset_peak

if TYPE_CHECKING:
    Arrays = tuple[NDArray[Any], NDArray[Any]]
    Work = Callable[[], dict[str, int]]
    Result = dict[str, Any]

SIZES = (61, 194)
"""Lattice sizes of the generator: about 0.1 and 1 million faces."""
TWIN = "audit, NumPy"
PACKAGES = ("numpy", "scipy", "libigl", "pymeshlab")


def twin(points: NDArray[Any], faces: NDArray[Any]) -> Work:
    """Prepare the audit's NumPy twin."""
    from msb.topology.analysis import Analysis
    from msb.topology.findings import find_by_numpy

    def work() -> dict[str, int]:
        found = find_by_numpy(Analysis(points, faces)).counts
        return {"components": found.components, "faces": found.faces}

    return work


def step(name: str) -> Callable[[NDArray[Any], NDArray[Any]], Work]:
    """Return the tool that runs one of our steps."""

    def prepare(points: NDArray[Any], faces: NDArray[Any]) -> Work:
        from msb.topology import steps

        function: Any = getattr(steps, name)
        first = len(points) if name in ("orient", "cut") else points

        def work() -> dict[str, int]:
            change = function(faces, first) if name in ("orient", "cut") else function(first, faces)
            return {"vertices": len(change.vertex_map), "faces": len(change.faces)}

        return work

    return prepare


def igl_cut(points: NDArray[Any], faces: NDArray[Any]) -> Work:
    """Prepare libigl's cut."""
    import igl

    wide = faces.astype(np.int64)

    def work() -> dict[str, int]:
        new, vertex_map = igl.split_nonmanifold(wide)
        return {"vertices": len(vertex_map), "faces": len(new)}

    return work


def _pymeshlab(*filters: tuple[str, dict[str, Any]]) -> Callable[[NDArray[Any], NDArray[Any]], Work]:
    def prepare(points: NDArray[Any], faces: NDArray[Any]) -> Work:
        import pymeshlab

        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(points.astype(np.float64), faces))

        def work() -> dict[str, int]:
            for name, options in filters:
                meshes.apply_filter(name, **options)
            mesh = meshes.current_mesh()
            return {"vertices": mesh.vertex_number(), "faces": mesh.face_number()}

        return work

    return prepare


TOOLS: dict[str, Callable[[NDArray[Any], NDArray[Any]], Work]] = {
    TWIN: twin,
    **{name: step(name) for name in ("orient", "cut", "pair", "drop", "debris", "close", "weld")},
    "igl.split_nonmanifold": igl_cut,
    "PyMeshLab remove faces": _pymeshlab(
        ("meshing_repair_non_manifold_edges", {"method": "Remove Faces"}),
        ("meshing_repair_non_manifold_vertices", {}),
    ),
    "PyMeshLab small pieces": _pymeshlab(
        ("meshing_remove_connected_component_by_face_number", {"mincomponentsize": 10})
    ),
}


def measure(tool: str, folder: Path) -> None:
    """Run one measurement in this process and print it as JSON."""
    from msb.topology.arrays import mesh_arrays

    points, faces = mesh_arrays(*(np.load(folder / f"{name}.npy") for name in ("vertices", "faces")))
    TOOLS[tool](points[:3], np.zeros((1, 3), faces.dtype) + np.arange(3, dtype=faces.dtype))()  # imports
    work = TOOLS[tool](points, faces)
    before, start = reset_peak(), time.process_time()
    answers = work()
    seconds = time.process_time() - start
    print(json.dumps({"seconds": seconds, "bytes": peak() - before, "answers": answers}))


def run(tool: str, folder: Path) -> Result:
    """Run one measurement in a separate process; return its result or the reason for its failure."""
    command = [sys.executable, "-m", "benchmarks.repair", "--worker", tool, "--folder", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        return {"error": (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]}
    return dict(json.loads(lines[-1]))


def table(folder: Path, faces: int, tools: list[str], rounds: int) -> list[Result]:
    """Measure the tools on one mesh, and print a row for each."""
    found: dict[str, list[Result]] = {tool: [] for tool in tools}
    for _ in range(rounds):
        for tool in tools:
            found[tool].append(run(tool, folder))
    print(f"\n{faces:,} faces, shuffled; median of {rounds}")
    print(f"{'tool':<24}{'seconds':>9}{'/ twin':>8}{'B/face':>8}  result")
    rows = []
    for tool, results in found.items():
        good = [one for one in results if "seconds" in one]
        if not good:
            print(f"{tool:<24}  {results[0]['error']}")
            rows.append({"tool": tool, "error": results[0]["error"]})
            continue
        seconds = statistics.median(one["seconds"] for one in good)
        pairs = zip(found[TWIN], results, strict=True)
        ratio = statistics.median(b["seconds"] / a["seconds"] for a, b in pairs if {"seconds"} <= {*a, *b})
        memory = statistics.median(one["bytes"] for one in good) / faces
        answers = ", ".join(f"{value:,} {key}" for key, value in good[0]["answers"].items())
        print(f"{tool:<24}{seconds:>9.2f}{ratio:>8.2f}{memory:>8.0f}  {answers}", flush=True)
        rows.append(
            {"tool": tool, "seconds": seconds, "ratio": ratio, "bytes_per_face": memory, "rounds": good}
        )
    return rows


def main() -> None:
    """Measure all sizes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="lattice sizes (n)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--tools", nargs="+", choices=TOOLS, default=list(TOOLS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        measure(options.worker, options.folder)
        return
    from data_stubs.splat_like import splat_like

    record: Result = {"machine": machine(*PACKAGES), "sizes": {}}
    print(", ".join(f"{key} {value}" for key, value in record["machine"].items()))
    tools = list(dict.fromkeys([TWIN, *options.tools]))
    for n in options.sizes:
        with tempfile.TemporaryDirectory(prefix="msb-bench-") as name:
            folder, (points, faces) = Path(name), splat_like(n)
            np.save(folder / "vertices.npy", points)
            np.save(folder / "faces.npy", faces)
            record["sizes"][len(faces)] = table(folder, len(faces), tools, options.rounds)
    keep(record, options.json)


if __name__ == "__main__":
    main()
