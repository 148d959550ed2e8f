"""Audit speed against libigl, PyMeshLab and trimesh, on the same arrays in one run.

    python -m benchmarks.audit                       0.1, 1 and 4 million faces, three rounds
    python -m benchmarks.audit --sizes 61 --rounds 5 about 0.1 million faces only

Every measurement is one fresh process that loads the arrays, does its work on one triangle unmeasured
(unless --cold: then first-use costs count), and once measured. Tools take turns within a round, so a machine
whose speed drifts treats them alike; printed are the median and the ratio to ours of the same round. Memory
is the rise of the process's high-water mark above the loaded arrays and libraries.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.measure import machine, peak, reset_peak

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Arrays = tuple[NDArray[Any], NDArray[Any]]
    Answers = dict[str, float]

SIZES = (61, 194, 388)
"""Lattice sizes of the generator: about 0.1, 1 and 4 million faces."""
WHAT = {
    "msb": "the whole audit: every count, metric, variant and sample",
    "pymeshlab": "get_topological_measures alone, without adding the mesh",
    "pymeshlab+mesh": "the same with adding the mesh",
    "trimesh": "edges, adjacency, two-face components, areas",
    "igl": "edges, boundary, vertex manifoldness, components, areas",
    "scatter": "floor: one random scatter of 3F int32",
}


def ours(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare our audit."""
    import msb

    def work() -> Answers:
        audit = msb.audit(vertices, faces)
        c = audit.counts
        return {
            "edges": c.edges,
            "boundary_edges": c.boundary_edges,
            "components": c.components,
            "components_two_face": c.components_manifold_edges,
            "nm_vertices_off_nm_edges": c.nonmanifold_vertices - c.nonmanifold_edge_endpoints,
            "multifan_vertices": c.multifan_vertices,
            "area": round(audit.metrics.total_area, 6),
        }

    return work


def pymeshlab(vertices: NDArray[Any], faces: NDArray[Any], *, add: bool = False) -> Callable[[], Answers]:
    """Prepare PyMeshLab; `add` times the mesh copy too."""
    import pymeshlab as library

    def mesh_set() -> Any:
        meshes = library.MeshSet()
        meshes.add_mesh(library.Mesh(vertices.astype(np.float64), faces))
        return meshes

    ready = None if add else mesh_set()

    def work() -> Answers:
        measures = (ready or mesh_set()).get_topological_measures()
        return {
            "edges": measures["edges_number"],
            "boundary_edges": measures["boundary_edges"],
            "components": measures["connected_components_number"],
            "nm_vertices_off_nm_edges": measures["non_two_manifold_vertices"],
        }

    return work


def pymeshlab_with_mesh(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare PyMeshLab, the mesh copy timed."""
    return pymeshlab(vertices, faces, add=True)


def igl(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare libigl."""
    import igl as library

    points, triangles = vertices.astype(np.float64), faces.astype(np.int64)

    def work() -> Answers:
        edges = library.edges(triangles)
        boundary = library.boundary_facets(triangles)[0]
        manifold = np.asarray(library.is_vertex_manifold(triangles))
        components = library.facet_components(triangles)
        count = int(np.max(components[1] if isinstance(components, tuple) else components)) + 1
        return {
            "edges": len(edges),
            "boundary_edges": len(boundary),
            "components": count,
            "multifan_vertices": int(np.count_nonzero(~manifold)),
            "area": round(float(library.doublearea(points, triangles).sum() / 2), 6),
        }

    return work


def trimesh(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare trimesh, without the merging it does by default."""
    import trimesh as library

    mesh = library.Trimesh(vertices.astype(np.float64), faces.astype(np.int64), process=False)

    def work() -> Answers:
        uses = np.bincount(mesh.edges_unique_inverse)
        labels = library.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
        return {
            "edges": len(mesh.edges_unique),
            "boundary_edges": int(np.count_nonzero(uses == 1)),
            "components_two_face": int(labels.max()) + 1,
            "area": round(float(mesh.area), 6),
        }

    return work


def scatter(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare the floor: 3F int32 written to random places."""
    place = np.random.default_rng(0).permutation(faces.size)
    values, out = np.arange(faces.size, dtype=np.int32), np.zeros(faces.size, np.int32)

    def work() -> Answers:
        out[place] = values
        return {}

    return work


TOOLS: dict[str, Callable[[Any, Any], Callable[[], Answers]]] = {
    "msb": ours,
    "pymeshlab": pymeshlab,
    "pymeshlab+mesh": pymeshlab_with_mesh,
    "trimesh": trimesh,
    "igl": igl,
    "scatter": scatter,
}


def measure(tool: str, folder: Path, warm: bool) -> None:
    """Do one measurement in this process and print it as JSON."""
    vertices, faces = (np.load(folder / f"{name}.npy") for name in ("vertices", "faces"))
    work = TOOLS[tool](vertices, faces)
    if warm:
        TOOLS[tool](vertices[:3], np.array([[0, 1, 2]], faces.dtype))()
    before = reset_peak()
    start = time.perf_counter()
    answers = work()
    seconds = time.perf_counter() - start
    print(json.dumps({"seconds": seconds, "bytes": peak() - before, "answers": answers}))


def run_round(tools: list[str], folder: Path, cold: bool) -> dict[str, dict[str, Any]]:
    """Return one measurement of each tool, each in its own process."""
    results = {}
    for tool in tools:
        command = [sys.executable, "-m", "benchmarks.audit", "--worker", tool, "--folder", str(folder)]
        done = subprocess.run([*command, *(["--cold"] if cold else [])], capture_output=True, text=True)
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            reason = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
            results[tool] = {"error": reason}
        else:
            results[tool] = json.loads(lines[-1])
    return results


def summarise(rounds: list[dict[str, dict[str, Any]]], faces: int) -> list[dict[str, Any]]:
    """Return a row per tool: medians over the rounds, and whether the answers are ours."""
    rows = []
    for tool in rounds[0]:
        good = [r for r in rounds if "seconds" in r[tool]]
        if not good:
            rows.append({"tool": tool, "error": rounds[0][tool]["error"]})
            continue
        reference = good[0]["msb"].get("answers", {})
        answers = good[0][tool]["answers"]
        differs = {k: [v, reference[k]] for k, v in answers.items() if k in reference and v != reference[k]}
        rows.append(
            {
                "tool": tool,
                "seconds": statistics.median(r[tool]["seconds"] for r in good),
                "ratio": statistics.median(r[tool]["seconds"] / r["msb"]["seconds"] for r in good),
                "bytes_per_face": statistics.median(r[tool]["bytes"] for r in good) / faces,
                "differs": differs,
            }
        )
    return rows


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="lattice sizes (n)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--tools", nargs="+", choices=list(TOOLS), default=list(TOOLS))
    parser.add_argument("--cold", action="store_true", help="count what only the first call costs")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--worker", choices=list(TOOLS), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        measure(options.worker, options.folder, not options.cold)
        return
    from data_stubs.splat_like import splat_like

    tools = ["msb", *(tool for tool in options.tools if tool != "msb")]
    about = machine("numpy", "scipy", "libigl", "pymeshlab", "trimesh")
    record: dict[str, Any] = {"machine": about, "cold": options.cold, "what": WHAT, "sizes": []}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    for n in options.sizes:
        vertices, faces = splat_like(n)
        with tempfile.TemporaryDirectory() as name:
            np.save(Path(name) / "vertices.npy", vertices)
            np.save(Path(name) / "faces.npy", faces)
            count = len(faces)
            del vertices, faces
            rounds = [run_round(tools, Path(name), options.cold) for _ in range(options.rounds)]
        rows = summarise(rounds, count)
        record["sizes"].append({"n": n, "faces": count, "rounds": rounds, "rows": rows})
        print_table(count, options.rounds, rows)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(record, indent=1) + "\n")


def print_table(faces: int, rounds: int, rows: list[dict[str, Any]]) -> None:
    """Print the rows of one mesh size."""
    print(f"\n{faces:,} faces, shuffled; median of {rounds}")
    print(f"{'tool':<16}{'seconds':>9}{'/ ours':>8}{'B/face':>8}  what it does")
    for row in rows:
        if "error" in row:
            print(f"{row['tool']:<16}  failed: {row['error']}")
            continue
        print(
            f"{row['tool']:<16}{row['seconds']:>9.3f}{row['ratio']:>8.2f}{row['bytes_per_face']:>8.0f}"
            f"  {WHAT[row['tool']]}"
        )
        for key, (theirs, own) in row["differs"].items():
            print(f"{'':<16}  DIFFERS: {key} is {theirs}, ours {own}")


if __name__ == "__main__":
    main()
