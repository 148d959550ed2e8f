"""Documents of other commands as JSON, whole: what records hold of an audit, trials, repairs, a distance."""

from dataclasses import fields
from typing import Any

from msb.bench.documents import STORED
from msb.topology.audit import Metrics
from msb.topology.findings import Counts

AUDIT: dict[str, Any] = {
    "schema": "msb.audit/1",
    "path": "x.triasset",
    "method": None,
    "topology": "indexed_mesh",
    "is_soup": False,
    "verdict": {
        "level": "bad",
        "sentence": "renders; not usable for subdivision, booleans or printing because 18 % of its "
        "edges and 65 % of its vertices are non-manifold",
    },
    "counts": {field.name: 0 for field in fields(Counts)}
    | {"vertices": 520, "faces": 1000, "edges": 1690, "nonmanifold_vertices": 338, "boundary_edges": 760,
       "nonmanifold_edges": 304, "components": 710_000, "largest_component_faces": 700},
    "metrics": {field.name: 1.0 for field in fields(Metrics)}
    | {"vf_ratio": 0.52, "mean_valence": 6.49, "boundary_edge_ratio": 0.45, "nonmanifold_edge_ratio": 0.18,
       "nonmanifold_vertex_ratio": 0.65, "lcc_face_ratio": 0.70, "lcc_area_ratio": 0.69,
       "components": 710_000, "euler_characteristic": -170},
    "variants": {},
    "winding_consistent": True,
    "valence_histogram": {},
    "samples": {},
    "welded": None,
    "cross_check": None,
    "timings_ms": {},
    "computed_by": "NumPy",
}  # fmt: skip
WALK: dict[str, Any] = {
    "frames": 24,
    "width": 160,
    "height": 120,
    "flicker": 1.25,
    "flicker_worst": 2.5,
    "worst_frame": 1,
    "holes": 0.01,
    "film": None,
    "seconds": 1.0,
}
TASK: dict[str, Any] = {
    "task": "uv",
    "title": "UV unwrapping",
    "outcome": "fails",
    "why": "it falls into <9> charts",
    "seconds": 1.25,
    "numbers": {},
    "libraries": {},
    "says": "9 charts",
    "files": ["uv.png"],
    "picture": "uv.png",
}
SAME = {"psnr": None, "same": True, "why": None}


def chamfer(overall: float) -> dict[str, Any]:
    """Return a distance in mm."""
    return {
        "mean_d2s": 1,
        "mean_s2d": 1,
        "overall": overall,
        "reason": None,
        "metric": {"name": "chamfer_dtu"},
        "mesh": "x.triasset",
    }


def trial(*tasks: dict[str, Any]) -> dict[str, Any]:
    """Return what became of tasks."""
    return {
        "schema": "msb.trial/1",
        "path": None,
        "trials": list(tasks),
        "mesh": {},
        "limits": {},
        "cameras": {},
    }


def way(strategy: str, /, **changes: Any) -> dict[str, Any]:
    """Return a strategy of 100 faces that changes nothing and lets one of three tasks work."""
    found = {
        "strategy": strategy,
        "plan": [] if strategy == STORED else strategy.split(","),
        "peer": None,
        "why": None,
        "faces_kept": 100,
        "faces_added": 0,
        "edges_cut": 0,
        "vertices": 60,
        "components": 4,
        "boundary_edge_ratio": 0.5,
        "nonmanifold_edges": 1,
        "nonmanifold_vertices": 2,
        "inconsistent_winding_edges": 0,
        "verdict_before": "bad",
        "verdict_after": "bad",
        "looks": {"standard": SAME, "dedicated": SAME},
        "trials": {"uv": "fails", "solid": "fails", "boolean": "care"},
        "trials_passed_before": 1,
        "trials_passed_after": 1,
        "bytes": 1 << 20,
        "seconds": 0.25,
        "picture": None,
    }
    return {**found, **changes}


def repairs(*ways: dict[str, Any]) -> dict[str, Any]:
    """Return a comparison of strategies."""
    return {
        "schema": "msb.repair_compare/1",
        "path": None,
        "views": "3 test views",
        "strategies": list(ways),
    }
