"""Predict the answers of each peer about a mesh. The predictions follow from the differences between the
peer's definitions and ours.

The prediction is our number plus the effect of each difference. This module computes the effects from the
mesh. A disagreement is therefore always a bug, even if the definitions differ. Almost every effect comes from
faces with a repeated index. In our definitions, faces with a repeated index have no edges. For most peers,
these faces have three vertex pairs.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from msb.topology.analysis import Analysis
from msb.topology.audit import Audit
from msb.topology.components import label_components
from msb.topology.crosscheck.pairs import count_pairs
from msb.topology.crosscheck.peers import Answer
from msb.topology.findings import Counts


@dataclass(frozen=True)
class Expected:
    """The expected answer of a peer: our number, the expected number, and the reason for the difference.

    Attributes
    ----------
    quantity : str
        Key of the audit's JSON.
    call, answer : str
        The function of the peer, and the name of the number in the peer's answers.
    ours, theirs : number, flag or None
        Our value, and the value that the peer's definition gives on this mesh.
    why : str
        The difference between the definitions. The text is empty if the definitions agree on this mesh.
    plus : int
        A number that is added to the peer's answer before comparing (in derived rows).
    slack : float
        Maximum accepted difference between the answer and `theirs`. The tolerance covers rounding of areas,
        or a documented quirk of the peer.
    unfit : str
        The reason why the peer's answer is meaningless on this mesh. The text is empty for a meaningful
        answer.
    """

    quantity: str
    call: str
    answer: str
    ours: Answer
    theirs: Answer
    why: str
    plus: int = 0
    slack: float = 0
    unfit: str = ""


class Facts:
    """The properties of a mesh for which the definitions of peers differ from ours."""

    def __init__(self, report: Audit, analysis: Analysis) -> None:
        self.report = report
        self.counts = report.counts
        self.analysis = analysis
        mesh = analysis.mesh
        self.repeated = int(np.count_nonzero(mesh.repeated_index))
        self.shift: Mapping[str, int] = defaultdict(int)
        self.with_all_rows: Mapping[str, int] = {}
        if self.repeated:
            proper = count_pairs(mesh.faces[~mesh.repeated_index])
            self.with_all_rows = count_pairs(mesh.faces)
            self.shift = {key: n - proper[key] for key, n in self.with_all_rows.items()}

    def same(self, quantity: str, call: str, shift: str | None = None) -> Expected:
        """Expect our count. If the peer also counts repeated-index faces, add the number of these faces."""
        ours = getattr(self.counts, quantity)
        by = self.shift[shift] if shift else 0
        return Expected(quantity, call, quantity, ours, ours + by, self.rows_kept(by))

    def rows_kept(self, by: int) -> str:
        """Return the reason for counting repeated-index faces, or "" if these faces do not change the
        number.
        """
        if by == 0:
            return ""
        return f"it counts the vertex pairs and corners of {self.rows}, which we exclude"

    @property
    def rows(self) -> str:
        """The number of repeated-index faces in words."""
        return format_count(self.repeated, "repeated-index row")

    def area(self, call: str) -> Expected:
        """Expect our area.

        If a corner is not finite, return None: the peer's area is then NaN.
        """
        ours = self.report.metrics.total_area
        if self.counts.nonfinite_faces:
            faces = format_count(self.counts.nonfinite_faces, "face")
            why = f"its sum is not finite because of {faces} with an area that we count as 0"
            return Expected("total_area", call, "total_area", ours, None, why)
        points = self.analysis.vertices[np.unique(self.analysis.mesh.faces)].astype(np.float64)
        with np.errstate(over="ignore"):
            extent = float(np.ptp(points, axis=0).max())
        # Sums of areas in different orders agree to 1e-9 of the area. The second term allows for thin
        # triangles, whose areas can be pure rounding errors.
        slack = 1e-9 * ours + 1e-14 * extent * extent * self.counts.faces
        return Expected("total_area", call, "total_area", ours, ours, "", slack=slack)

    def loops(self, call: str, unfit: str = "") -> Expected:
        """Expect our number of boundary loops. Skip meshes for which the peer does not define boundary
        loops."""
        if self.repeated:
            unfit = "not defined for meshes with repeated-index rows"
        elif self.counts.nonmanifold_vertices:
            unfit = "defined for manifold meshes only"
        return replace(self.same("boundary_loops", call), unfit=unfit)

    def without_seams(self, flag: Expected, holds: Callable[[Counts], bool]) -> Expected:
        """Expect that a peer reports a mesh with seams as open.

        The peer gets the mesh as stored, with duplicated vertices.
        """
        if flag.ours or flag.theirs or not holds(self.report.judged.counts):
            return flag
        rows = format_count(self.counts.seam_vertices, "row")
        return replace(flag, ours=True, why=f"it treats the {rows} duplicated at seams as a border")

    def euler(self, call: str, vertices: int, which: str, edges: str) -> Expected:
        """Expect the Euler characteristic of a peer that counts other vertices and edges than our audit.

        The peer counts `vertices` vertices. The text `which` describes these vertices in a message. The
        peer's edges include the vertex pairs of repeated-index faces.
        """
        ours = self.report.metrics.euler_characteristic
        fewer = vertices - self.counts.vertices
        parts = [f"it counts the vertices {which}, {vertices} of {self.counts.vertices}"] if fewer else []
        if self.shift[edges]:
            parts.append(self.rows_kept(-self.shift[edges]))
        theirs = ours + fewer - self.shift[edges]
        return Expected("euler_characteristic", call, "euler_characteristic", ours, theirs, "; ".join(parts))


def expect_libigl(facts: Facts) -> list[Expected]:
    """Return the expected answers of libigl."""
    highest = int(facts.analysis.mesh.faces.max()) + 1
    pairs = "igl.unique_edge_map"
    rows = [
        facts.same("edges", "igl.edges", "igl_edges"),
        facts.same("boundary_edges", "igl.boundary_facets", "single"),
        facts.same("manifold_edges", pairs, "double"),
        facts.same("nonmanifold_edges", pairs, "crowded"),
        facts.same("max_edge_faces", pairs, "most"),
        facts.same("nonmanifold_edge_endpoints", pairs, "endpoints"),
        facts.same("multifan_vertices", "igl.is_vertex_manifold on used vertices", "multifan"),
        facts.same("nonmanifold_vertices", f"is_vertex_manifold or endpoint in {pairs}", "strict"),
        facts.same("components", "igl.facet_components", "components"),
        facts.same("largest_component_faces", "igl.facet_components", "largest"),
        facts.euler("igl.euler_characteristic", highest, "up to the largest index used", "igl_edges"),
        facts.area("igl.doublearea"),
    ]
    winding = "" if facts.report.winding_consistent else "it follows the winding, which is inconsistent"
    return [*rows, facts.loops("igl.boundary_loop_all", winding)]


def expect_pymeshlab(facts: Facts) -> list[Expected]:
    """Return the expected answers of PyMeshLab's get_topological_measures."""
    ours, endpoints = facts.counts.nonmanifold_vertices, facts.counts.nonmanifold_edge_endpoints
    faces = facts.analysis.mesh.faces
    vague = len(np.unique(faces[facts.analysis.mesh.repeated_index]))
    # PyMeshLab's count may be wrong at the corners of repeated-index faces. The count is reliable elsewhere.
    quirk = f"; its result is arbitrary for the {vague} vertices of {facts.rows}" if vague else ""
    crowded = facts.same("nonmanifold_edges", "non_two_manifold_edges (first call)", "crowded_by_rows")
    again = "it may count an edge again for each such row at it" if facts.repeated else ""
    skips = f"it skips {format_count(endpoints, 'endpoint')} of non-manifold edges" if endpoints else ""
    rows = [
        facts.same("vertices", "vertices_number"),
        facts.same("faces", "faces_number"),
        facts.same("unreferenced_vertices", "unreferenced_vertices", "unused"),
        facts.same("edges", "edges_number", "pairs"),
        facts.same("boundary_edges", "boundary_edges", "single"),
        replace(crowded, why="; ".join(filter(None, [crowded.why, again])), slack=facts.repeated),
        Expected(
            "nonmanifold_vertices", "non_two_manifold_vertices", "off_edge_vertices",
            ours, ours - endpoints, (skips + quirk).removeprefix("; "), slack=vague,
        ),
        Expected(
            "nonmanifold_vertices", "non_two_manifold_vertices + our edge endpoints", "off_edge_vertices",
            ours, ours, quirk.removeprefix("; "), plus=endpoints, slack=vague,
        ),
        facts.same("components", "connected_components_number", "components"),
    ]  # fmt: skip
    return [*rows, facts.loops("number_holes")]


def expect_trimesh(facts: Facts) -> list[Expected]:
    """Return the expected answers of trimesh."""
    mesh, counts = facts.analysis.mesh, facts.counts
    bodies, _ = label_components(
        mesh.vertex_count, mesh.faces[:, :2].T.reshape(-1), mesh.faces[:, 1:].T.reshape(-1)
    )
    unique = "edges_unique_inverse"
    used = counts.referenced_vertices + facts.shift["used"]
    closed = _is_closed(counts)
    consistent = counts.inconsistent_winding_edges == 0
    sees_closed, sees_consistent = closed, consistent
    if facts.repeated:
        pair_counts = facts.with_all_rows
        sees_closed = pair_counts["single"] == pair_counts["crowded"] == 0
        sees_consistent = pair_counts["inconsistent"] == 0
    return [
        facts.same("referenced_vertices", "referenced_vertices", "used"),
        facts.same("edges", "edges_unique", "pairs"),
        facts.same("boundary_edges", unique, "single"),
        facts.same("manifold_edges", unique, "double"),
        facts.same("nonmanifold_edges", unique, "crowded"),
        facts.same("max_edge_faces", unique, "most"),
        facts.same("components_manifold_edges", "face_adjacency", "two_face_components"),
        Expected(
            "components", "body_count", "bodies", counts.components, bodies,
            "it joins faces through vertices, not edges, and counts each unreferenced vertex",
        ),
        facts.euler("euler_number", used, "that a face uses", "pairs"),
        facts.area("area"),
        _expect_flag("winding_consistent", "is_winding_consistent", consistent, sees_consistent, facts),
        facts.without_seams(_expect_flag("closed", "is_watertight", closed, sees_closed, facts), _is_closed),
    ]  # fmt: skip


def _expect_flag(quantity: str, call: str, ours: bool, theirs: bool, facts: Facts) -> Expected:
    """Expect a flag that differs from our flag only because of repeated-index faces."""
    why = "" if ours == theirs else f"it counts the vertex pairs of {facts.rows}"
    return Expected(quantity, call, quantity, ours, theirs, why)


def expect_manifold3d(facts: Facts) -> list[Expected]:
    """Return whether manifold3d should accept the mesh.

    manifold3d pairs half-edges in opposite directions. Therefore manifold3d accepts an edge with two faces in
    each direction. manifold3d requires at least four vertices and four faces.
    """
    counts, mesh = facts.counts, facts.analysis.mesh
    ours = _is_oriented(counts)
    upwards = mesh.origin[mesh.edge_halfedges] < mesh.target[mesh.edge_halfedges]
    surplus = np.bincount(
        mesh.edge[mesh.edge_halfedges], weights=np.where(upwards, 1, -1), minlength=mesh.edge_count
    )
    theirs = not surplus.any() and counts.vertices >= 4 and counts.faces >= 4
    why = ""
    if theirs and not ours:
        why = "it pairs opposite half-edges, so it accepts an edge with equally many faces in both directions"
    elif ours and not theirs:
        why = "it rejects fewer than four vertices or faces"
    expected = Expected("closed_oriented", "status", "closed_oriented", ours, theirs, why)
    return [facts.without_seams(expected, _is_oriented)]


def _is_closed(counts: Counts) -> bool:
    return counts.boundary_edges == counts.nonmanifold_edges == 0 < counts.edges


def _is_oriented(counts: Counts) -> bool:
    return _is_closed(counts) and counts.inconsistent_winding_edges == 0


def expect_networkx(facts: Facts) -> list[Expected]:
    """Return the expected answers of NetworkX.

    The answers equal our numbers, because the graphs follow our definitions.
    """
    names = {
        "edges": "vertex graph",
        "nonmanifold_edges": "vertex graph, three faces and more",
        "nonmanifold_edge_endpoints": "vertex graph, three faces and more",
        "multifan_vertices": "vertex links in pieces",
        "nonmanifold_vertices": "vertex links with several parts, or with a node of degree three or more",
        "components": "face graph, all shared edges",
        "largest_component_faces": "face graph, all shared edges",
        "components_manifold_edges": "face graph, two-face edges",
    }
    return [facts.same(quantity, call) for quantity, call in names.items()]


def expect_nvidia(facts: Facts) -> list[Expected]:
    """Return the expected answers of the ManifoldChecker of NVIDIA's validator.

    NVIDIA's checker joins the faces at a vertex across two-face edges only. Each end of a non-manifold edge
    therefore has several groups of faces. Therefore the checker's count equals our strict count.
    """
    counts = facts.counts
    unused = counts.unreferenced_vertices - facts.shift["used"]
    vertices = facts.same("nonmanifold_vertices", "ManifoldChecker", "double_fans")
    theirs = counts.nonmanifold_vertices + facts.shift["double_fans"] + unused
    idle = (
        f"it counts {format_count(unused, 'vertex', 'vertices')} without faces as non-manifold"
        if unused
        else ""
    )
    consistent = sees_consistent = counts.inconsistent_winding_edges == 0
    if facts.repeated:
        pair_counts = facts.with_all_rows
        sees_consistent = pair_counts["inconsistent"] == pair_counts["double_loops"] == 0
    return [
        facts.same("nonmanifold_edges", "ManifoldChecker", "crowded"),
        replace(vertices, theirs=theirs, why="; ".join(filter(None, [vertices.why, idle]))),
        _expect_flag("winding_consistent", "ManifoldChecker", consistent, sees_consistent, facts),
    ]


def format_count(count: int, noun: str, several: str = "") -> str:
    """Return a count with its noun, such as "1 row" or "2 rows"."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {several or noun + 's'}"


# Each peer's function that returns the expected answers.
EXPECTED = {
    "libigl": expect_libigl,
    "PyMeshLab": expect_pymeshlab,
    "manifold3d": expect_manifold3d,
    "trimesh": expect_trimesh,
    "NetworkX": expect_networkx,
    "NVIDIA": expect_nvidia,
}
