"""The offending elements themselves, as arrays: what `--elements` writes and viewers draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.topology.analysis import Analysis


@dataclass(frozen=True)
class Elements:
    """Offending elements of a mesh by kind, and its components.

    Attributes
    ----------
    vertices : (V, 3) floating
        All vertices of the mesh.
    faces : (F, 3) integers
        All faces.
    edges : dict of str to (n, 2) integers
        Vertex pairs: "boundary", "nonmanifold", "inconsistent_winding".
    points : dict of str to (n,) integers
        Vertices: "multifan" (a bow-tie), "nonmanifold_edge_endpoint", "unreferenced". A strictly
        non-manifold vertex is in one or both of the first two.
    marked_faces : dict of str to (n,) integers
        Faces: "repeated_index", "zero_area", "nonfinite", "duplicate".
    face_component : (F,) integers
        Edge-connected component of each face, numbered by size, largest first; -1 in repeated-index rows.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any]
    edges: dict[str, NDArray[Any]]
    points: dict[str, NDArray[Any]]
    marked_faces: dict[str, NDArray[Any]]
    face_component: NDArray[Any]


def find_elements(analysis: Analysis) -> Elements:
    """Return the offending elements behind the audit of `analysis`."""
    mesh = analysis.mesh
    ends = mesh.edge_vertices
    return Elements(
        vertices=analysis.vertices,
        faces=mesh.faces,
        edges={
            "boundary": ends[analysis.boundary.edges],
            "nonmanifold": ends[analysis.nonmanifold_edges],
            "inconsistent_winding": ends[analysis.inconsistent_winding_edges],
        },
        points={
            "multifan": analysis.multifan_vertices,
            "nonmanifold_edge_endpoint": analysis.nonmanifold_edge_endpoints,
            "unreferenced": np.flatnonzero(~analysis.referenced),
        },
        marked_faces={
            "repeated_index": np.flatnonzero(mesh.repeated_index),
            "zero_area": analysis.zero_area_faces,
            "nonfinite": np.flatnonzero(~analysis.finite),
            "duplicate": np.flatnonzero(analysis.duplicate),
        },
        face_component=_by_size(analysis),
    )


def _by_size(analysis: Analysis) -> NDArray[Any]:
    """Return the component of each face, renumbered so that 0 is the audit's largest component."""
    components = analysis.components
    if components.count == 0:
        return components.face_component
    order = np.lexsort((np.arange(components.count), -components.areas, -components.sizes))
    rank = np.zeros(components.count + 1, components.face_component.dtype)
    rank[order] = np.arange(components.count)
    rank[-1] = -1  # what NONE, an index of -1, looks up
    return np.asarray(rank[components.face_component])
