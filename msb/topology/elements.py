"""The offending elements with their vertices: what `--elements` writes and viewers draw."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.analysis import Analysis


@dataclass(frozen=True)
class Group:
    """Elements of one kind: their numbers (n,), and their vertices (n, 1), (n, 2) or (n, 3)."""

    kind: str
    numbers: NDArray[Any]
    vertices: NDArray[Any]


@dataclass(frozen=True)
class Elements:
    """A mesh with its offending elements and its components.

    `groups` are vertices, then edges, then faces; kinds are keys of the audit's counts, and an edge's number
    is its place in the order of vertex pairs. `face_component` (F,) is numbered by size, largest first; -1 in
    repeated-index rows.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any]
    groups: tuple[Group, ...]
    face_component: NDArray[Any]


def find_elements(analysis: Analysis) -> Elements:
    """Return the offending elements behind the audit of `analysis`."""
    mesh, bad = analysis.mesh, analysis.offending
    groups = [
        *(Group(kind, ids, ids[:, None]) for kind, ids in bad.vertices.items()),
        *(Group(kind, ids, mesh.edge_vertices[ids]) for kind, ids in bad.edges.items()),
        *(Group(kind, ids, mesh.faces[ids]) for kind, ids in bad.faces.items()),
    ]
    return Elements(analysis.vertices, mesh.faces, tuple(groups), _by_size(analysis))


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
