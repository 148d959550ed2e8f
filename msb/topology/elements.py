"""Faulty elements with their vertices, for the option `--elements` and for viewers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.analysis import Analysis


@dataclass(frozen=True)
class ElementGroup:
    """Elements of one kind. The fields are the indices (n,) and the vertices (n, 1), (n, 2) or (n, 3)."""

    kind: str
    numbers: NDArray[Any]
    vertices: NDArray[Any]


@dataclass(frozen=True)
class Elements:
    """A mesh with its faulty elements and its components.

    The field `groups` is sorted in the order vertices, edges, faces. The kinds of elements are keys of the
    audit's counts. The index of an edge is its position among the sorted vertex pairs. The field
    `face_component` (F,) numbers components by size, the largest first. The component is -1 for faces with a
    repeated index.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any]
    groups: tuple[ElementGroup, ...]
    face_component: NDArray[Any]


def find_elements(analysis: Analysis) -> Elements:
    """Return the faulty elements that the audit of `analysis` counts."""
    mesh, offending = analysis.mesh, analysis.offending
    groups = [
        *(ElementGroup(kind, ids, ids[:, None]) for kind, ids in offending.vertices.items()),
        *(ElementGroup(kind, ids, mesh.edge_vertices[ids]) for kind, ids in offending.edges.items()),
        *(ElementGroup(kind, ids, mesh.faces[ids]) for kind, ids in offending.faces.items()),
    ]
    return Elements(analysis.vertices, mesh.faces, tuple(groups), _rank_by_size(analysis))


def _rank_by_size(analysis: Analysis) -> NDArray[Any]:
    """Return the component (F,) of each face, renumbered so that 0 is the largest component of the audit."""
    components = analysis.components
    if components.count == 0:
        return components.face_component
    order = np.lexsort((np.arange(components.count), -components.areas, -components.sizes))
    rank = np.zeros(components.count + 1, components.face_component.dtype)
    rank[order] = np.arange(components.count)
    rank[-1] = -1  # The value -1 (NONE) stays -1.
    return np.asarray(rank[components.face_component])
