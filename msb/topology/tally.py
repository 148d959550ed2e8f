"""Add up the counts and element lists from all work-items of the audit kernels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.findings import SAMPLES, Counts, Findings, First, first_of

EDGE_KINDS = ("nonmanifold_edges", "boundary_edges", "inconsistent_winding_edges")
# Keys of the vertex counts in the order of audit_types.cl.
VERTEX_KINDS = (
    "nonmanifold_vertices",
    "multifan_vertices",
    "nonmanifold_edge_endpoints",
    "unreferenced_vertices",
)


def tally_dtype(valences: int) -> np.dtype[Any]:
    """Return the struct `Tally` of audit_types.cl as a dtype.

    The valence table of the struct has `valences` entries.
    """
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
    """The results of all kernel stages of an audit.

    Attributes
    ----------
    vertex_count : int
    faces : (F, 3) int32
    improper : (chunks, 1 + SAMPLES) uint32
        For each chunk of faces, the number of faces with a repeated index, and the first of these faces.
    strange : (chunks, 2, 1 + SAMPLES) uint32
        The same values for faces with zero area, and for faces with a non-finite area.
    tallies : (workers + 1,) `tally_dtype`
    block_edges : (blocks,) uint64
        For each block, the number of edges whose lower vertex is in the block.
    valences : (n,) uint32
        The valences above the table of the tallies, one value per vertex.
    components, two_face_components, boundary_loops : int
    largest : int
        Number of faces in the largest component.
    area, largest_area : float
        Total area, and area of the largest component.
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
    """Return the findings. The caller can add further stages to the dict `timings_ms`."""
    tallies = totals.tallies
    kinds = (*EDGE_KINDS, *VERTEX_KINDS)
    sums = [*tallies["edge_counts"].sum(axis=0), *tallies["vertex_counts"].sum(axis=0)]
    count_of = {kind: int(count) for kind, count in zip(kinds, sums, strict=True)}
    edges = int(totals.block_edges.sum())
    zero_area, nonfinite = totals.strange[:, :, 0].sum(axis=0)
    counts = Counts(
        vertices=totals.vertex_count,
        referenced_vertices=totals.vertex_count - count_of["unreferenced_vertices"],
        faces=len(totals.faces),
        repeated_index_faces=int(totals.improper[:, 0].sum()),
        zero_area_faces=int(zero_area),
        nonfinite_faces=int(nonfinite),
        duplicate_faces=int(tallies["duplicate_faces"].sum()),
        edges=edges,
        manifold_edges=edges - count_of["boundary_edges"] - count_of["nonmanifold_edges"],
        max_edge_faces=int(tallies["max_edge_faces"].max()),
        boundary_loops=totals.boundary_loops,
        # A closed loop has as many links as edges. In an open chain, the number of links is one below the
        # number of edges.
        open_boundary_chains=count_of["boundary_edges"] - int(tallies["rim_links"].sum()),
        components=totals.components,
        components_manifold_edges=totals.two_face_components,
        largest_component_faces=totals.largest,
        **count_of,
    )
    return Findings(
        counts=counts,
        shares_vertices=bool(tallies["shared_vertices"].any()),
        total_area=totals.area,
        largest_component_area=totals.largest_area,
        valence_histogram=_build_histogram(tallies["valences"].sum(axis=0), totals.valences),
        first=_collect_first(totals),
        timings_ms=timings_ms,
        computed_by=computed_by,
    )


def _build_histogram(table: NDArray[Any], others: NDArray[Any]) -> dict[int, int]:
    """Return the number of vertices of each valence. The numbers come from the table and from the list of
    larger valences."""
    valences, counts = np.unique(others, return_counts=True)
    low = {int(k): int(table[k]) for k in np.flatnonzero(table)}
    return low | {int(k): int(n) for k, n in zip(valences, counts, strict=True)}


def _collect_first(totals: Totals) -> First:
    """Return the lowest faulty elements of each kind among the samples of all work-items."""
    tallies, improper, strange = totals.tallies, totals.improper, totals.strange
    first: First = {}
    for kind, name in enumerate(EDGE_KINDS):
        # The index of an edge is its rank in its block, plus the number of edges in all earlier blocks.
        edges = _collect_filled(tallies["edges"][:, kind], tallies["edge_counts"][:, kind])
        before = np.cumsum(totals.block_edges) - totals.block_edges
        numbers = before[edges["block"].astype(np.int64)] + edges["rank"]
        lowest = np.argsort(numbers)[:SAMPLES]
        first[name] = tuple((int(numbers[i]), (int(edges["low"][i]), int(edges["high"][i]))) for i in lowest)
    for kind, name in enumerate(VERTEX_KINDS):
        vertices = _collect_filled(tallies["vertices"][:, kind], tallies["vertex_counts"][:, kind])
        first[name] = first_of(np.sort(vertices))
    faces = {
        "repeated_index_faces": _collect_filled(improper[:, 1:], improper[:, 0]),
        "zero_area_faces": _collect_filled(strange[:, 0, 1:], strange[:, 0, 0]),
        "nonfinite_faces": _collect_filled(strange[:, 1, 1:], strange[:, 1, 0]),
        "duplicate_faces": _collect_filled(tallies["duplicates"], tallies["duplicate_faces"]),
    }
    for name, numbers in faces.items():
        first[name] = first_of(np.sort(numbers).astype(np.int64), totals.faces)
    return first


def _collect_filled(rows: NDArray[Any], counts: NDArray[Any]) -> NDArray[Any]:
    """Return the valid entries of all sample rows. Row i has counts[i] valid entries at most."""
    return np.concatenate([row[: int(n)] for row, n in zip(rows, counts, strict=True)])
