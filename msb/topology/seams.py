"""Whether a mesh is open only where coincident vertices are stored more than once: at UV seams, say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.dispatch import find
from msb.topology.weld import weld_vertices

if TYPE_CHECKING:
    from msb.topology.findings import Counts, Findings

MOST_FACES = 200_000
"""Welding and auditing again takes as long as the audit: larger meshes are not welded unasked."""


def is_closed(counts: Counts) -> bool:
    """Return whether a mesh has faces and is closed, manifold and consistently wound, with no face twice."""
    return counts.faces > counts.repeated_index_faces and not (
        counts.boundary_edges
        or counts.nonmanifold_vertices
        or counts.inconsistent_winding_edges
        or counts.duplicate_faces
    )


def closes_at_seams(findings: Findings, points: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether the exact weld closes an open mesh of at most `MOST_FACES` faces; else False.

    `findings` are those of the mesh as stored.
    """
    counts = findings.counts
    if not counts.boundary_edges or counts.faces > MOST_FACES:
        return False
    # What welding does not mend, and what it would mend everywhere: nearly all meshes end here.
    if counts.nonmanifold_edges or counts.inconsistent_winding_edges or counts.duplicate_faces:
        return False
    if not _at_seams([edge for _, edge in findings.first["boundary_edges"]], points):
        return False
    return is_closed(find(*weld_vertices(points, faces, "exact"))[0].counts)


def _at_seams(edges: list[tuple[int, ...]], points: NDArray[Any]) -> bool:
    """Return whether an end of each edge has the float32 coordinates of another vertex.

    A boundary edge that a weld removes has such an end: had both ends none, the edge would stay as it is.
    """
    with np.errstate(over="ignore"):
        places = points.astype(np.float32)
    return all(
        any(np.count_nonzero((places == places[vertex]).all(axis=1)) > 1 for vertex in edge) for edge in edges
    )
