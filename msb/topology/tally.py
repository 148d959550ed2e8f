"""Add up what the work-items of the audit's kernels have counted and listed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.findings import SAMPLES, Counts, Findings, First, first_of

EDGE_KINDS = ("nonmanifold_edges", "boundary_edges", "inconsistent_winding_edges")
# Keys of the counts of vertices, in the order of audit_types.cl.
VERTEX_KINDS = (
    "nonmanifold_vertices",
    "multifan_vertices",
    "nonmanifold_edge_endpoints",
    "unreferenced_vertices",
)


def tally_dtype(valences: int) -> np.dtype[Any]:
    """Return the `Tally` of audit_types.cl, whose table of valences has so many entries."""
    edge = [(name, "u8") for name in ("block", "rank", "low", "high")]
    counts = ("max_edge_faces", "rim_links", "shared_vertices", "duplicate_faces")
    return np.dtype(
        [
            *((name, "u8") for name in counts),
            ("edge_counts", "u8", len(EDGE_KINDS)),
            ("vertex_counts", "u8", len(VERTEX_KINDS)),
            ("edges", edge, (len(EDGE_KINDS), SAMPLES)),
            ("vertices", "u8", (len(VERTEX_KINDS), SAMPLES)),
            ("duplicates", "u8", SAMPLES),
            ("valences", "u8", valences),
        ]
    )


@dataclass(frozen=True)
class Totals:
    """The results of all stages.

    Attributes
    ----------
    vertex_count : int
    faces : (F, 3) int32
    improper : (chunks, 1 + SAMPLES) uint32
        Number of repeated-index faces in each chunk of the faces, and the first of them.
    strange : (chunks, 2, 1 + SAMPLES) uint32
        The same for faces without area, and for faces whose area is not finite.
    tallies : (workers + 1,) `tally_dtype`
    block_edges : (blocks,) uint64
        Number of edges by the block of their lower vertex.
    valences : (n,) uint32
        Valence of each vertex whose valence is not in the tallies' tables.
    components, two_face_components, boundary_loops, largest : int
        The last one is the number of faces in the largest component.
    area, largest_area : float
    """

    vertex_count: int
    faces: NDArray[np.int32]
    improper: NDArray[np.uint32]
    strange: NDArray[np.uint32]
    tallies: NDArray[Any]
    block_edges: NDArray[np.uint64]
    valences: NDArray[np.uint32]
    components: int
    two_face_components: int
    boundary_loops: int
    largest: int
    area: float
    largest_area: float


def add_up(totals: Totals, timings_ms: dict[str, float], computed_by: str) -> Findings:
    """Return the findings; `timings_ms` is kept, not copied, so that it may still grow."""
    tallies = totals.tallies
    kinds = (*EDGE_KINDS, *VERTEX_KINDS)
    sums = [*tallies["edge_counts"].sum(axis=0), *tallies["vertex_counts"].sum(axis=0)]
    listed = {kind: int(count) for kind, count in zip(kinds, sums, strict=True)}
    edges = int(totals.block_edges.sum())
    zero_area, nonfinite = totals.strange[:, :, 0].sum(axis=0)
    counts = Counts(
        vertices=totals.vertex_count,
        referenced_vertices=totals.vertex_count - listed["unreferenced_vertices"],
        faces=len(totals.faces),
        repeated_index_faces=int(totals.improper[:, 0].sum()),
        zero_area_faces=int(zero_area),
        nonfinite_faces=int(nonfinite),
        duplicate_faces=int(tallies["duplicate_faces"].sum()),
        edges=edges,
        manifold_edges=edges - listed["boundary_edges"] - listed["nonmanifold_edges"],
        max_edge_faces=int(tallies["max_edge_faces"].max()),
        boundary_loops=totals.boundary_loops,
        # A chain has one link fewer than edges, a loop as many.
        open_boundary_chains=listed["boundary_edges"] - int(tallies["rim_links"].sum()),
        components=totals.components,
        components_manifold_edges=totals.two_face_components,
        largest_component_faces=totals.largest,
        **listed,
    )
    return Findings(
        counts=counts,
        shares_vertices=bool(tallies["shared_vertices"].any()),
        total_area=totals.area,
        largest_component_area=totals.largest_area,
        valence_histogram=_histogram(tallies["valences"].sum(axis=0), totals.valences),
        first=_first(totals),
        timings_ms=timings_ms,
        computed_by=computed_by,
    )


def _histogram(table: NDArray[Any], others: NDArray[Any]) -> dict[int, int]:
    """Return valence -> vertices: those of the table, then those whose valences are listed one by one."""
    valences, counts = np.unique(others, return_counts=True)
    low = {int(k): int(table[k]) for k in np.flatnonzero(table)}
    return low | {int(k): int(n) for k, n in zip(valences, counts, strict=True)}


def _first(totals: Totals) -> First:
    """Return the lowest elements of each kind among those that the work-items met first."""
    tallies, improper, strange = totals.tallies, totals.improper, totals.strange
    first: First = {}
    for kind, name in enumerate(EDGE_KINDS):
        edges = _filled(tallies["edges"][:, kind], tallies["edge_counts"][:, kind])
        before = np.cumsum(totals.block_edges) - totals.block_edges
        numbers = before[edges["block"].astype(np.int64)] + edges["rank"]
        lowest = np.argsort(numbers)[:SAMPLES]
        first[name] = tuple((int(numbers[i]), (int(edges["low"][i]), int(edges["high"][i]))) for i in lowest)
    for kind, name in enumerate(VERTEX_KINDS):
        vertices = _filled(tallies["vertices"][:, kind], tallies["vertex_counts"][:, kind])
        first[name] = first_of(np.sort(vertices))
    faces = {
        "repeated_index_faces": _filled(improper[:, 1:], improper[:, 0]),
        "zero_area_faces": _filled(strange[:, 0, 1:], strange[:, 0, 0]),
        "nonfinite_faces": _filled(strange[:, 1, 1:], strange[:, 1, 0]),
        "duplicate_faces": _filled(tallies["duplicates"], tallies["duplicate_faces"]),
    }
    for name, numbers in faces.items():
        first[name] = first_of(np.sort(numbers).astype(np.int64), totals.faces)
    return first


def _filled(rows: NDArray[Any], counts: NDArray[Any]) -> NDArray[Any]:
    """Return the entries of rows of samples, one after the other: as many as were counted, if they fit."""
    return np.concatenate([row[: int(n)] for row, n in zip(rows, counts, strict=True)])
