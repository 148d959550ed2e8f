"""The audit: every count and metric of a mesh's structure, and the report made of them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, overload

import numpy as np

from msb.errors import MeshError
from msb.topology.analysis import Analysis, Offending, analyse
from msb.topology.arrays import mesh_arrays
from msb.topology.weld import Weld, parse_weld, weld_vertices

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

SCHEMA = "msb.audit/1"
SAMPLES = 3
"""Offending elements shown of each kind: enough to go and look, few enough to read."""


@dataclass(frozen=True)
class Counts:
    """Integers. `msb-audit --explain NAME` prints the definition of each (docs/definitions.md)."""

    vertices: int
    referenced_vertices: int
    unreferenced_vertices: int
    faces: int
    repeated_index_faces: int
    zero_area_faces: int
    nonfinite_faces: int
    duplicate_faces: int
    edges: int
    boundary_edges: int
    manifold_edges: int
    nonmanifold_edges: int
    max_edge_faces: int
    nonmanifold_vertices: int
    multifan_vertices: int
    nonmanifold_edge_endpoints: int
    inconsistent_winding_edges: int
    boundary_loops: int
    open_boundary_chains: int
    components: int
    components_manifold_edges: int
    largest_component_faces: int


@dataclass(frozen=True)
class Metrics:
    """The paper's columns and what belongs to them. A ratio whose denominator is zero is None."""

    vf_ratio: float | None
    mean_valence: float | None
    boundary_edge_ratio: float | None
    nonmanifold_edge_ratio: float | None
    nonmanifold_vertex_ratio: float | None
    lcc_face_ratio: float | None
    lcc_area_ratio: float | None
    components: int
    euler_characteristic: int
    total_area: float
    largest_component_area: float


@dataclass(frozen=True)
class Welded:
    """The same numbers after merging coincident vertices."""

    weld: Weld
    counts: Counts
    metrics: Metrics


@dataclass(frozen=True)
class Sample:
    """One offending element: its number, its vertices and their coordinates (stored precision)."""

    element: int
    vertices: tuple[int, ...]
    coordinates: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Audit:
    """What the audit found about one mesh.

    Attributes
    ----------
    path, method : str or None
        Where the mesh came from, and the asset's method; None for plain arrays.
    topology : {"triangle_soup", "indexed_mesh"}
        Read from the data: a soup when no vertex is used by two faces.
    is_soup : bool
        Every vertex is used by exactly one face, so V = 3F.
    counts, metrics : Counts, Metrics
    valence_histogram : dict of int to int
        Number of edges at a vertex -> number of such vertices, unreferenced ones included.
    winding_consistent : bool
        No two-face edge is run along in the same direction by both its faces.
    samples : dict of str to tuple of Sample
        The first few elements behind each count, in ascending order.
    welded : Welded or None
    cross_check : list or None
        Rows of `msb.topology.crosscheck`.
    timings_ms : dict of str to float
        Stage -> milliseconds.
    """

    topology: Literal["triangle_soup", "indexed_mesh"]
    is_soup: bool
    counts: Counts
    metrics: Metrics
    valence_histogram: dict[int, int]
    winding_consistent: bool
    samples: dict[str, tuple[Sample, ...]]
    timings_ms: dict[str, float]
    path: str | None = None
    method: str | None = None
    welded: Welded | None = None
    cross_check: list[dict[str, Any]] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the audit as JSON data (schema msb.audit/1); no NaN, no infinity."""
        counts, metrics = asdict(self.counts), asdict(self.metrics)
        welded = self.welded and {
            "weld": self.welded.weld,
            "counts": asdict(self.welded.counts),
            "metrics": asdict(self.welded.metrics),
        }
        return {
            "schema": SCHEMA,
            "path": self.path,
            "method": self.method,
            "topology": self.topology,
            "is_soup": self.is_soup,
            "counts": counts,
            "metrics": metrics,
            "variants": self.variants(),
            "winding_consistent": self.winding_consistent,
            "valence_histogram": {str(k): n for k, n in self.valence_histogram.items()},
            "samples": {
                kind: [
                    {
                        "element": sample.element,
                        "vertices": list(sample.vertices),
                        "coordinates": [[_finite(x) for x in point] for point in sample.coordinates],
                    }
                    for sample in samples
                ]
                for kind, samples in self.samples.items()
            },
            "welded": welded,
            "cross_check": self.cross_check,
            "timings_ms": self.timings_ms,
        }

    def variants(self) -> dict[str, dict[str, int]]:
        """Return the readings of the two ambiguous terms, by name; the first of each is the headline."""
        c = self.counts
        return {
            "nonmanifold_vertices": {
                "strict": c.nonmanifold_vertices,
                "multifan": c.multifan_vertices,
                "edge_endpoints": c.nonmanifold_edge_endpoints,
                "off_nonmanifold_edges": c.nonmanifold_vertices - c.nonmanifold_edge_endpoints,
            },
            "components": {
                "all_shared_edges": c.components,
                "manifold_edges_only": c.components_manifold_edges,
            },
        }


class MeshAsset(Protocol):
    """What the audit needs of an `msb.Asset`; this package takes arrays and knows no files."""

    @property
    def manifest(self) -> Any: ...
    @property
    def buffers(self) -> Mapping[str, NDArray[Any]]: ...
    @property
    def path(self) -> Path | None: ...


@overload
def audit(vertices: MeshAsset, *, weld: Weld | None = None) -> Audit: ...
@overload
def audit(vertices: ArrayLike, faces: ArrayLike, *, weld: Weld | None = None) -> Audit: ...
def audit(vertices: Any, faces: ArrayLike | None = None, *, weld: Weld | None = None) -> Audit:
    """Audit the structure of a triangle mesh exactly as it is stored.

    Nothing is merged, dropped, reoriented or repaired first (paper: "Mesh structural integrity" and
    appendix "Topology-Metric Definitions and Interpretation Limits").

    Parameters
    ----------
    vertices : (V, 3) real numbers, or Asset
        In any length unit; NaN is allowed and counted. Or a whole asset, and then no `faces`.
    faces : (F, 3) integers
        0-based vertex indices.
    weld : "exact" or float, optional
        Also audit the mesh with coincident vertices merged (`weld_vertices`).

    Returns
    -------
    Audit

    Raises
    ------
    MeshError
        `MESH_ARRAY`, `MESH_INDEX_OUT_OF_RANGE`, `MESH_TOO_LARGE`, `WELD_DISTANCE` or `WELD_TOO_WIDE`.

    Notes
    -----
    O((V + F) log F) time.

    Examples
    --------
    A book of three pages has one non-manifold edge and two non-manifold vertices, its ends:

    >>> import msb
    >>> points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]]
    >>> book = msb.audit(points, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> book.counts.nonmanifold_edges, book.counts.nonmanifold_vertices, book.counts.components
    (1, 2, 1)
    """
    if faces is not None:
        return audit_arrays(vertices, faces, weld=weld)[0]
    if not hasattr(vertices, "buffers"):
        raise MeshError("MESH_ARRAY", "faces are missing; give an asset, or vertices and faces")
    asset: MeshAsset = vertices
    report, _ = audit_arrays(asset.buffers["positions"], asset.buffers["indices"], weld=weld)
    path = None if asset.path is None else str(asset.path)
    return replace(report, path=path, method=asset.manifest.method)


def audit_arrays(
    vertices: ArrayLike, faces: ArrayLike, *, weld: Weld | None = None
) -> tuple[Audit, Analysis]:
    """Return the audit of plain arrays together with the analysis behind it (for viewers and exports)."""
    points, triangles = mesh_arrays(vertices, faces)
    analysis = analyse(points, triangles)
    report = summarise(analysis)
    if weld is not None:
        chosen = parse_weld(weld)
        merged = summarise(analyse(*weld_vertices(points, triangles, chosen)))
        report = replace(report, welded=Welded(chosen, merged.counts, merged.metrics))
    return report, analysis


def summarise(analysis: Analysis) -> Audit:
    """Return the audit's numbers from an analysis."""
    found = analysis.offending
    counts = _counts(analysis, found)
    degree = np.bincount(analysis.mesh.edge_vertices.reshape(-1), minlength=counts.vertices)
    histogram = np.bincount(degree)
    return Audit(
        topology="triangle_soup" if analysis.soup else "indexed_mesh",
        is_soup=analysis.soup
        and counts.faces > 0
        and counts.vertices == counts.referenced_vertices == 3 * counts.faces,
        counts=counts,
        metrics=_metrics(analysis, counts),
        valence_histogram={int(k): int(histogram[k]) for k in np.flatnonzero(histogram)},
        winding_consistent=counts.inconsistent_winding_edges == 0,
        samples=_samples(analysis, found),
        timings_ms=dict(analysis.timings_ms),
    )


def _counts(analysis: Analysis, found: Offending) -> Counts:
    mesh, components = analysis.mesh, analysis.components
    listed = {
        kind: len(ids) for group in (found.edges, found.vertices, found.faces) for kind, ids in group.items()
    }
    largest = components.largest()
    return Counts(
        vertices=mesh.vertex_count,
        referenced_vertices=mesh.vertex_count - listed["unreferenced_vertices"],
        faces=mesh.face_count,
        edges=mesh.edge_count,
        manifold_edges=int(np.count_nonzero(mesh.multiplicity == 2)),
        max_edge_faces=int(mesh.multiplicity.max(initial=0)),
        boundary_loops=analysis.boundary.loops,
        open_boundary_chains=analysis.boundary.open_chains,
        components=components.count,
        components_manifold_edges=analysis.two_face_components,
        largest_component_faces=0 if largest is None else int(components.sizes[largest]),
        **listed,
    )


def _metrics(analysis: Analysis, counts: Counts) -> Metrics:
    largest = analysis.components.largest()
    total = float(analysis.area.sum())
    area = 0.0 if largest is None else float(analysis.components.areas[largest])
    return Metrics(
        vf_ratio=_ratio(counts.vertices, counts.faces),
        mean_valence=_ratio(2 * counts.edges, counts.vertices),
        boundary_edge_ratio=_ratio(counts.boundary_edges, counts.edges),
        nonmanifold_edge_ratio=_ratio(counts.nonmanifold_edges, counts.edges),
        nonmanifold_vertex_ratio=_ratio(counts.nonmanifold_vertices, counts.vertices),
        lcc_face_ratio=None if largest is None else _ratio(counts.largest_component_faces, counts.faces),
        lcc_area_ratio=None if largest is None else _ratio(area, total),
        components=counts.components,
        euler_characteristic=counts.vertices - counts.edges + counts.faces,
        total_area=total,
        largest_component_area=area,
    )


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def _samples(analysis: Analysis, found: Offending) -> dict[str, tuple[Sample, ...]]:
    mesh = analysis.mesh
    groups = [
        *((kind, ids[:SAMPLES], mesh.edge_vertices) for kind, ids in found.edges.items()),
        *((kind, ids[:SAMPLES], None) for kind, ids in found.vertices.items()),
        *((kind, ids[:SAMPLES], mesh.faces) for kind, ids in found.faces.items()),
    ]
    return {
        kind: tuple(
            _sample(analysis.vertices, int(i), np.array([i]) if table is None else table[i]) for i in ids
        )
        for kind, ids, table in groups
    }


def _sample(points: NDArray[Any], element: int, vertices: NDArray[Any]) -> Sample:
    places = tuple((float(x), float(y), float(z)) for x, y, z in points[vertices])
    return Sample(element, tuple(map(int, vertices)), places)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
