"""Meshes that the topology tests share: golden cases, and random meshes with many kinds of faults."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.topology.analysis import Analysis
from msb.topology.arrays import mesh_arrays
from msb.topology.findings import Counts, find_by_numpy
from msb.topology.halfedge import NONE
from msb.topology.steps import Change
from tests.conftest import ROOT

Mesh = tuple[np.ndarray, np.ndarray]
GOLDEN = ROOT / "tests" / "golden" / "meshes"


@dataclass(frozen=True)
class Case:
    """A hand-made mesh with hand-derived counts."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    expected: dict[str, Any]

    @property
    def valid(self) -> bool:
        return "error" not in self.expected


def _points(rows: list[list[float | None]]) -> np.ndarray:
    return np.array([[np.nan if x is None else x for x in row] for row in rows]).reshape(-1, 3)


CASES = [
    Case(c["name"], _points(c["vertices"]), np.array(c["faces"], np.int64).reshape(-1, 3), c["expected"])
    for c in json.loads((GOLDEN / "cases.json").read_text())["cases"]
]
CASE = {case.name: case for case in CASES}

# The JSON keys of the symbols in formulas. With E_max_faces, these are all expected fields.
COUNT_OF = {
    "V": "vertices",
    "F": "faces",
    "V_referenced": "referenced_vertices",
    "V_unreferenced": "unreferenced_vertices",
    "F_repeated_index": "repeated_index_faces",
    "F_zero_area": "zero_area_faces",
    "F_nonfinite": "nonfinite_faces",
    "F_duplicate_extra": "duplicate_faces",
    "E": "edges",
    "E1": "boundary_edges",
    "E2": "manifold_edges",
    "E_gt2": "nonmanifold_edges",
    "V_nm": "nonmanifold_vertices",
    "V_nm_multifan": "multifan_vertices",
    "V_nm_edge_endpoint": "nonmanifold_edge_endpoints",
    "components": "components",
    "components_two_face_edges": "components_manifold_edges",
    "LCC_faces": "largest_component_faces",
}
METRIC_OF = {
    "LCC_area": "largest_component_area",
    "total_area": "total_area",
    "v_over_f": "vf_ratio",
    "valence": "mean_valence",
    "boundary_edge_ratio": "boundary_edge_ratio",
    "nm_edge_ratio": "nonmanifold_edge_ratio",
    "nm_vertex_ratio": "nonmanifold_vertex_ratio",
    "lcc_face": "lcc_face_ratio",
    "lcc_area": "lcc_area_ratio",
    "euler": "euler_characteristic",
}


def assert_as_expected(audit: Any, expected: dict[str, Any]) -> None:
    """Assert every expected field: integers exactly, real numbers to 1e-9."""
    assert set(expected) == {*COUNT_OF, *METRIC_OF, "E_max_faces"}
    counts, metrics = vars(audit.counts), vars(audit.metrics)
    assert {k: counts[key] for k, key in COUNT_OF.items()} == {k: expected[k] for k in COUNT_OF}
    assert max(2, counts["max_edge_faces"]) == expected["E_max_faces"]
    for symbol, key in METRIC_OF.items():
        if expected[symbol] is None:
            assert metrics[key] is None, symbol
        else:
            np.testing.assert_allclose(metrics[key], expected[symbol], rtol=1e-9, err_msg=symbol)


def random_mesh(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a small mesh with few vertices and many faces, so that most kinds of faults occur often."""
    v = int(rng.integers(1, 11))
    f = int(rng.integers(0, 15))
    faces = rng.integers(0, v, (f, 3))
    if v >= 3 and rng.random() < 0.7:  # mostly without repeated indices
        faces = np.array([rng.permutation(v)[:3] for _ in range(f)], np.int64).reshape(-1, 3)
        strange = rng.random(f) < 0.1
        faces[strange, 1] = faces[strange, 0]
    if f and rng.random() < 0.3:  # duplicates, some with reversed winding
        again = faces[rng.integers(0, f, 2)]
        faces = np.concatenate([faces, again[:1], again[1:, ::-1]])
    if v >= 4 and rng.random() < 0.5:  # a closed tetrahedron among other faces
        a, b, c, d = rng.permutation(v)[:4]
        faces = np.concatenate([faces, [[b, c, d], [a, d, c], [a, b, d], [a, c, b]]])
    # With integer coordinates, areas are often exactly zero, and often equal.
    points = rng.integers(-2, 3, (v + int(rng.integers(0, 3)), 3)).astype(float)
    points[rng.random(points.shape) < 0.01] = np.nan
    points[rng.random(points.shape) < 0.01] = np.inf
    return points, faces[rng.permutation(len(faces))]


def finite_mesh(seed: int) -> Mesh:
    """Return a random mesh without NaN. With odd seeds, the vertices are in general position."""
    rng = np.random.default_rng(seed)
    points, faces = random_mesh(rng)
    points = rng.normal(size=points.shape) if seed % 2 else np.nan_to_num(points, posinf=1, neginf=-1)
    return mesh_arrays(points, faces)


def counts(points: np.ndarray, faces: np.ndarray) -> Counts:
    return find_by_numpy(Analysis(*mesh_arrays(points, faces))).counts


def places(points: np.ndarray, change: Change) -> np.ndarray:
    """Return the positions after a change: the old positions, and the average of each rim."""
    kept = points[change.vertex_map[change.vertex_map != NONE]]
    rims = np.split(change.rims.vertices, change.rims.offsets[1:-1]) if change.rims.count else []
    return np.concatenate([kept, np.array([points[rim].mean(axis=0) for rim in rims]).reshape(-1, 3)])


def sphere(sides: int) -> Mesh:
    """Return a closed double cone over a polygon with `sides` sides."""
    ring = np.arange(sides)
    angle = 2 * np.pi * ring / sides
    points = np.concatenate([np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1), [[0, 0, 1], [0, 0, -1]]])
    after = (ring + 1) % sides
    top, bottom = np.full(sides, sides), np.full(sides, sides + 1)
    return points, np.concatenate([np.stack([ring, after, top], 1), np.stack([after, ring, bottom], 1)])


def sheet(side: int, holes: tuple[tuple[int, int], ...] = ()) -> Mesh:
    """Return a flat grid of quads split into triangles, without the quads in `holes`."""
    points = np.array([[x, y, 0] for x in range(side + 1) for y in range(side + 1)], float)
    quads = [(x, y) for x in range(side) for y in range(side) if (x, y) not in holes]
    first, step = [x * (side + 1) + y for x, y in quads], side + 1
    halves = [((v, v + step, v + 1), (v + 1, v + step, v + step + 1)) for v in first]
    return points, np.array(halves).reshape(-1, 3)
