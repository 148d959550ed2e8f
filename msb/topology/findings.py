"""Findings of an audit as plain numbers. The NumPy code and the OpenCL kernels return findings of the same
form."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from msb.topology.analysis import Analysis
from msb.topology.faces import sum_areas

# Number of listed faulty elements of each kind.
SAMPLES = 3
# For each key of the counts, the first few faulty elements in ascending order. A faulty element is the pair
# (index of the element, its vertices).
First = dict[str, tuple[tuple[int, tuple[int, ...]], ...]]


@dataclass(frozen=True)
class Counts:
    """Integer counts.

    `msb-audit --explain NAME` prints the definition of a finding. The page docs/definitions.md has all
    definitions.
    """

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
    seam_vertices: int = 0

    @property
    def all_apart(self) -> bool:
        """Whether no two faces share a vertex, as in a triangle soup. The mesh may have degenerate faces.

        Faces with a repeated index are ignored. A mesh without valid faces is not a triangle soup.
        """
        return self.referenced_vertices == 3 * (self.faces - self.repeated_index_faces) > 0


@dataclass(frozen=True)
class Findings:
    """The counts of a mesh, and the other results that the report needs.

    Areas are in squared length units. Areas are added in face order, so both implementations give equal sums.
    The field `shares_vertices` is true if two faces share a vertex. The field `first` lists the first edges,
    vertices and faces of each count. The index of an edge is its position among the sorted vertex pairs.
    Comparisons ignore `timings_ms` and `computed_by`.
    """

    counts: Counts
    shares_vertices: bool
    total_area: float
    largest_component_area: float
    valence_histogram: dict[int, int]
    first: First
    timings_ms: dict[str, float] = field(compare=False)
    computed_by: str = field(compare=False)


def find_by_numpy(analysis: Analysis) -> Findings:
    """Return the findings of `analysis`, computed with NumPy.

    The module `msb.topology.kernel` computes the same findings with OpenCL.
    """
    mesh, components, bad = analysis.mesh, analysis.components, analysis.offending
    count_of = {kind: len(ids) for kind, ids in (bad.edges | bad.vertices | bad.faces).items()}
    largest = components.largest()
    counts = Counts(
        vertices=mesh.vertex_count,
        referenced_vertices=mesh.vertex_count - count_of["unreferenced_vertices"],
        faces=mesh.face_count,
        edges=mesh.edge_count,
        manifold_edges=int(np.count_nonzero(mesh.multiplicity == 2)),
        max_edge_faces=int(mesh.multiplicity.max(initial=0)),
        boundary_loops=analysis.boundary.loops,
        open_boundary_chains=analysis.boundary.open_chains,
        components=components.count,
        components_manifold_edges=analysis.two_face_components,
        largest_component_faces=0 if largest is None else int(components.sizes[largest]),
        **count_of,
    )
    valences = np.bincount(np.bincount(mesh.edge_vertices.reshape(-1), minlength=counts.vertices))
    return Findings(
        counts=counts,
        shares_vertices=not analysis.soup,
        total_area=float(sum_areas(analysis.area, np.zeros(mesh.face_count, np.intp), 1)[0]),
        largest_component_area=0.0 if largest is None else float(components.areas[largest]),
        valence_histogram={int(k): int(valences[k]) for k in np.flatnonzero(valences)},
        first={
            **{kind: first_of(ids, mesh.edge_vertices) for kind, ids in bad.edges.items()},
            **{kind: first_of(ids) for kind, ids in bad.vertices.items()},
            **{kind: first_of(ids, mesh.faces) for kind, ids in bad.faces.items()},
        },
        timings_ms=dict(analysis.timings_ms),
        computed_by="NumPy",
    )


def first_of(numbers: Any, vertices: Any = None) -> tuple[tuple[int, tuple[int, ...]], ...]:
    """Return the first few of the ascending element indices `numbers`. Also return the vertices of each
    element.

    Row i of `vertices` contains the vertices of element i. If `vertices` is None, the elements are vertices.
    """
    return tuple(
        (int(i), (int(i),) if vertices is None else tuple(map(int, vertices[i]))) for i in numbers[:SAMPLES]
    )
