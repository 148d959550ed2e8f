"""The audit of a mesh: all counts and metrics of its structure, and their report."""

from __future__ import annotations

import html
import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from numpy.typing import ArrayLike, NDArray

from msb.errors import one_line
from msb.topology.analysis import Analysis
from msb.topology.arrays import mesh_arrays
from msb.topology.dispatch import find_findings
from msb.topology.faces import find_duplicate_faces, names_vertex_twice
from msb.topology.findings import Counts, Findings
from msb.topology.seams import Attributes, Merged, SeamKind, audit_merged, find_seams, is_closed
from msb.topology.solids import Bodies, check_bodies
from msb.topology.verdict import Level, judge, percent
from msb.topology.weld import Weld, corners_coincide, parse_weld, weld_vertices

SCHEMA = "msb.audit/1"


@dataclass(frozen=True)
class Metrics:
    """The metrics of the table "Per-scene mesh diagnostics" of the paper, and related numbers.

    A ratio with a zero denominator is None. Areas are in squared length units of the mesh.
    """

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
    """Counts and metrics of a mesh after merging coincident vertices."""

    weld: Weld
    counts: Counts
    metrics: Metrics


@dataclass(frozen=True)
class Sample:
    """A faulty element: its index, its vertices, and the vertex coordinates in stored precision."""

    element: int
    vertices: tuple[int, ...]
    coordinates: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, repr=False)
class Audit:
    """The audit of a mesh.

    `print` shows the audit in a few lines. A notebook displays the audit as a small table.

    Attributes
    ----------
    path, method : str or None
        The file of the mesh, and the training method of the model. Both values are None for plain arrays.
    topology : {"triangle_soup", "indexed_mesh"}
        The value is "triangle_soup" if no vertex is used by two faces. Only the face indices are compared.
    is_soup : bool
        Whether every vertex is used by exactly one face, so that V = 3F.
    counts, metrics : Counts, Metrics
    valence_histogram : dict of int to int
        A histogram of the number of edges at a vertex (the valence). Vertices without faces have 0 edges.
    winding_consistent : bool
        Whether the two faces of every two-face edge run along that edge in opposite directions.
    samples : dict of str to tuple of Sample
        The first few elements of each count, in ascending order.
    welded : Welded or None
        The result of the requested weld.
    seams : {"texture", "color", "normal", "format"} or None
        The cause of the seams, namely texture coordinates, colours, attributes that the reader ignores (such
        as normals), or a format without shared vertices. The value is None for a mesh without seams.
    without_seams : Audit or None
        The audit of the mesh with merged seams. The value is None for a mesh without seams.
    closed_once_merged : bool
        Whether the mesh is open as stored, but closed, manifold and consistently wound after this weld.
        False if the mesh was not tested: with more than 200,000 faces, only a requested exact weld tests
        the mesh.
    merged : Merged or None
        The counts of an open mesh after an exact weld, for at most 200,000 faces. If needed, vertices of
        boundary edges that differ by rounding are merged as well. The value is None if no weld was computed.
    without_duplicates : Counts or None
        The counts of a non-manifold mesh without its duplicate faces. The value is None for a mesh without
        duplicate faces.
    bodies : Bodies or None
        Whether the bodies of a closed mesh are inside out, flat, touch or cross. The value is None for other
        meshes.
    corners_coincide : bool or None
        For a triangle soup, whether an exact weld would join any two faces. The value is None for other
        meshes.
    cross_check : list or None
        Rows of `msb.topology.crosscheck`.
    timings_ms : dict of str to float
        Milliseconds by stage.
    computed_by : str
        The value is "NumPy", or "OpenCL" and the device. NumPy and OpenCL give the same results.
    verdict : {"ok", "limited", "bad"}
        Whether the stored mesh is usable for all tasks, for some tasks, or for hardly any task.
    sentence : str
        A sentence that names the tasks for which the mesh is usable, and the faults of the mesh.
    """

    topology: Literal["triangle_soup", "indexed_mesh"]
    is_soup: bool
    counts: Counts
    metrics: Metrics
    valence_histogram: dict[int, int]
    winding_consistent: bool
    samples: dict[str, tuple[Sample, ...]]
    timings_ms: dict[str, float]
    computed_by: str
    path: str | None = None
    method: str | None = None
    welded: Welded | None = None
    seams: SeamKind | None = None
    without_seams: Audit | None = None
    closed_once_merged: bool = False
    merged: Merged | None = None
    without_duplicates: Counts | None = None
    bodies: Bodies | None = None
    corners_coincide: bool | None = None
    cross_check: list[dict[str, Any]] | None = None

    @property
    def judged(self) -> Audit:
        """The audit for the verdict. For a mesh with seams, this is the audit with merged seams."""
        return self.without_seams or self

    @property
    def verdict(self) -> Level:
        """The level of the verdict."""
        return judge(self).level

    @property
    def sentence(self) -> str:
        """The sentence of the verdict, without a final full stop."""
        return judge(self).sentence

    def __repr__(self) -> str:
        return f"<Audit {self.verdict}, {self._title()}>"

    def __str__(self) -> str:
        rows = self._rows()
        left, middle = (max(len(row[column]) for row in rows) for column in (0, 1))
        lines = [f"  {name:<{left}}  {count:>{middle}}  {share}".rstrip() for name, count, share in rows]
        return "\n".join([self._title(), *lines, str(judge(self))])

    def _repr_html_(self) -> str:
        """Return the table that a notebook displays, with the file name escaped."""
        right = ' style="text-align: right"'
        rows = "".join(
            f"<tr><td>{name}</td><td{right}>{count}</td><td{right}>{share}</td></tr>"
            for name, count, share in self._rows()
        )
        verdict = judge(self)
        return (
            f"<p><b>{verdict.word}</b>: {html.escape(verdict.sentence)}.</p>"
            f"<table><caption>{html.escape(self._title())}</caption>{rows}</table>"
        )

    def _title(self) -> str:
        name = one_line(self.path or "mesh") + (f" ({self.method})" if self.method else "")
        kind = "triangle list" if self.seams == "format" else self.topology.replace("_", " ")
        return f"{name}: {kind}, {self.counts.vertices:,} vertices, {self.counts.faces:,} faces"

    def _rows(self) -> list[tuple[str, str, str]]:
        """Return the name, the count and the share for each of the most important counts."""
        c = self.judged.counts
        rows = [
            (name, f"{count:,}", percent(count, whole))
            for name, count, whole in (
                ("boundary edges", c.boundary_edges, c.edges),
                ("non-manifold edges", c.nonmanifold_edges, c.edges),
                ("non-manifold vertices", c.nonmanifold_vertices, c.vertices),
            )
        ]
        largest = percent(c.largest_component_faces, c.faces)
        share = f"{largest} of the faces in the largest" if c.components else ""
        return [*rows, ("components", f"{c.components:,}", share)]

    def to_dict(self) -> dict[str, Any]:
        """Return the audit as JSON data (schema msb.audit/1), without NaN or infinity."""
        verdict = judge(self)
        welded = self.welded and {"weld": self.welded.weld, **_numbers_to_dict(self.welded)}
        without_seams = self.without_seams and {"kind": self.seams, **_numbers_to_dict(self.without_seams)}
        return {
            "schema": SCHEMA,
            "path": self.path,
            "method": self.method,
            "topology": self.topology,
            "is_soup": self.is_soup,
            "verdict": {"level": verdict.level, "sentence": verdict.sentence, "plan": verdict.plan or None},
            **_numbers_to_dict(self),
            "variants": self.variants(),
            "winding_consistent": self.winding_consistent,
            "valence_histogram": {str(k): n for k, n in self.valence_histogram.items()},
            "samples": {
                kind: [
                    {
                        "element": sample.element,
                        "vertices": list(sample.vertices),
                        "coordinates": [[_finite_or_none(x) for x in point] for point in sample.coordinates],
                    }
                    for sample in samples
                ]
                for kind, samples in self.samples.items()
            },
            "welded": welded,
            "without_seams": without_seams,
            "bodies": self.judged.bodies and asdict(self.judged.bodies),
            "cross_check": self.cross_check,
            "timings_ms": self.timings_ms,
            "computed_by": self.computed_by,
        }

    def variants(self) -> dict[str, dict[str, int]]:
        """Two terms of the audit have several definitions. Return the count for each definition of a term.

        The audit prints only the count for the first definition.
        """
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


def audit_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    weld: Weld | None = None,
    attributes: Attributes | None = None,
    check_crossings: bool = True,
) -> tuple[Audit, Analysis]:
    """Return the audit of plain arrays. Also return the analysis for viewers and exports.

    The argument `attributes` contains the UVs and colours for which a file may duplicate vertices at seams.
    The function `msb.topology.seams.seam_attributes` returns these attributes. If `check_crossings` is true,
    the audit also tests whether the bodies of a closed mesh cross. Kernels compute the audit of a large mesh.
    Each part of the analysis is computed when a caller uses the part.
    """
    points, triangles = mesh_arrays(vertices, faces)
    findings, analysis = find_findings(points, triangles)
    report = _build_report(findings, points)
    chosen = None if weld is None else parse_weld(weld)
    if chosen is not None:
        merged = find_findings(*weld_vertices(points, triangles, chosen))[0]
        report = replace(report, welded=Welded(chosen, merged.counts, _compute_metrics(merged)))
    seams = find_seams(points, triangles, attributes or {}) if report.counts.boundary_edges else None
    if seams is not None:
        counts = replace(report.counts, seam_vertices=seams.doubles)
        merged_faces = seams.merged(triangles)
        without, _ = audit_arrays(points[seams.first], merged_faces, check_crossings=check_crossings)
        without = replace(without, samples=_name_stored_vertices(without.samples, seams.first))
        report = replace(report, counts=counts, seams=seams.kind, without_seams=without)
    # Find the mesh after an exact weld, unless the requested weld is the exact weld.
    if report.welded is not None and chosen == "exact":
        after_weld = Merged("exact", report.welded.counts) if report.counts.boundary_edges else None
    elif report.without_seams is not None:
        after_weld = Merged("exact", report.without_seams.counts)
        if not is_closed(after_weld.counts):
            after_weld = report.without_seams.merged
    else:
        after_weld = audit_merged(findings, points, triangles)
    closes = after_weld is not None and is_closed(after_weld.counts)
    report = replace(report, merged=after_weld)
    # Count again without duplicate faces, and check the bodies of a closed mesh.
    if report.counts.duplicate_faces and report.counts.nonmanifold_vertices:
        single = triangles[~find_duplicate_faces(triangles)]
        report = replace(report, without_duplicates=find_findings(points, single)[0].counts)
    if check_crossings and is_closed(report.counts) and not report.counts.nonfinite_faces:
        report = replace(report, bodies=check_bodies(points, triangles, report.counts.components))
    # Test whether corners of a triangle soup coincide. Ignore faces with a repeated index.
    coincide = None
    if report.counts.all_apart:
        degenerate = report.counts.repeated_index_faces > 0
        proper = triangles[~names_vertex_twice(triangles)] if degenerate else triangles
        coincide = corners_coincide(points, proper)
    return replace(report, closed_once_merged=closes, corners_coincide=coincide), analysis


def _name_stored_vertices(
    samples: dict[str, tuple[Sample, ...]], first: NDArray[Any]
) -> dict[str, tuple[Sample, ...]]:
    """Return the samples with the vertex indices of the file.

    The merged vertex i has the index `first[i]` (W,) in the file.
    """
    return {
        kind: tuple(
            replace(
                sample,
                element=int(first[sample.element]) if kind.endswith("vertices") else sample.element,
                vertices=tuple(int(first[vertex]) for vertex in sample.vertices),
            )
            for sample in found
        )
        for kind, found in samples.items()
    }


def _build_report(findings: Findings, points: NDArray[Any]) -> Audit:
    counts = findings.counts
    return Audit(
        topology="indexed_mesh" if findings.shares_vertices else "triangle_soup",
        is_soup=counts.vertices == counts.referenced_vertices == 3 * counts.faces > 0,
        counts=counts,
        metrics=_compute_metrics(findings),
        valence_histogram=findings.valence_histogram,
        winding_consistent=counts.inconsistent_winding_edges == 0,
        samples={
            kind: tuple(_locate_sample(points, element, vertices) for element, vertices in first)
            for kind, first in findings.first.items()
        },
        timings_ms=dict(findings.timings_ms),
        computed_by=findings.computed_by,
    )


def _compute_metrics(findings: Findings) -> Metrics:
    counts, area = findings.counts, findings.largest_component_area
    empty = counts.components == 0
    return Metrics(
        vf_ratio=_divide(counts.vertices, counts.faces),
        mean_valence=_divide(2 * counts.edges, counts.vertices),
        boundary_edge_ratio=_divide(counts.boundary_edges, counts.edges),
        nonmanifold_edge_ratio=_divide(counts.nonmanifold_edges, counts.edges),
        nonmanifold_vertex_ratio=_divide(counts.nonmanifold_vertices, counts.vertices),
        lcc_face_ratio=None if empty else _divide(counts.largest_component_faces, counts.faces),
        lcc_area_ratio=None if empty else _divide(area, findings.total_area),
        components=counts.components,
        euler_characteristic=counts.vertices - counts.edges + counts.faces,
        total_area=findings.total_area,
        largest_component_area=area,
    )


def _numbers_to_dict(audited: Audit | Welded) -> dict[str, Any]:
    return {"counts": asdict(audited.counts), "metrics": asdict(audited.metrics)}


def _divide(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def _locate_sample(points: NDArray[Any], element: int, vertices: tuple[int, ...]) -> Sample:
    places = tuple((float(x), float(y), float(z)) for x, y, z in points[list(vertices)])
    return Sample(element, vertices, places)


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
