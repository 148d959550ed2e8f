"""Analysis of a mesh by vertex, edge and face. The audit counts these results, and viewers draw them."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from msb.base.soup import is_soup
from msb.topology.components import label_components
from msb.topology.faces import face_areas, find_duplicate_faces, has_no_area, sum_areas
from msb.topology.fans import Boundary, Fans, find_boundary, find_fans
from msb.topology.halfedge import NONE, HalfEdgeMesh, build_half_edges, face_of

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Components:
    """The edge-connected components of all faces without a repeated index.

    The field `face_component` (F,) is the component of each face, or NONE for faces with a repeated index.
    The field `sizes` (n,) has the number of faces of each component. The field `areas` (n,) has the areas in
    squared length units.
    """

    face_component: NDArray[Any]
    sizes: NDArray[Any]
    areas: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of components."""
        return len(self.sizes)

    def largest(self) -> int | None:
        """Return the component with most faces, or None for a mesh without components.

        If several components have the largest number of faces, return the component with the largest area. If
        the areas are equal, return the component with the lowest face index.
        """
        if self.count == 0:
            return None
        most = np.flatnonzero(self.sizes == self.sizes.max())
        return int(most[np.argmax(self.areas[most])])


@dataclass(frozen=True)
class Offending:
    """The indices (n,) of faulty elements in ascending order. The keys are the names of the audit's
    counts."""

    edges: dict[str, NDArray[Any]]
    vertices: dict[str, NDArray[Any]]
    faces: dict[str, NDArray[Any]]


class Analysis:
    """A mesh with its half-edges, fans, boundary, components and face properties.

    The arrays must come from `mesh_arrays`, which checks the arrays. Each part of the analysis is computed on
    first use with NumPy and SciPy. The time of each part is added to `timings_ms`, in milliseconds.
    """

    def __init__(self, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
        self.vertices = vertices
        self.faces = faces
        self.timings_ms: dict[str, float] = {}

    @cached_property
    def mesh(self) -> HalfEdgeMesh:
        """The half-edge structure."""
        return self._timed("half_edges", build_half_edges, self.faces, len(self.vertices))

    @cached_property
    def fans(self) -> Fans:
        """The fans around every vertex."""
        return self._timed("fans", find_fans, self.mesh)

    @cached_property
    def boundary(self) -> Boundary:
        """The boundary loops, and the boundary chains that do not close."""
        return self._timed("boundary", find_boundary, self.mesh, self.fans)

    @property
    def area(self) -> NDArray[np.float64]:
        """(F,) area of each face in squared length units. The value is 0 for an area that is not finite."""
        return self._areas[0]

    @property
    def finite(self) -> NDArray[np.bool_]:
        """(F,) whether the area of each face is finite."""
        return self._areas[1]

    @property
    def components(self) -> Components:
        """The connected components across all shared edges."""
        return self._components[0]

    @property
    def two_face_components(self) -> int:
        """The number of connected components across two-face edges only."""
        return self._components[1]

    @cached_property
    def duplicate(self) -> NDArray[np.bool_]:
        """(F,) whether each face repeats an earlier face."""
        return self._timed("duplicates", find_duplicate_faces, self.faces)

    @cached_property
    def soup(self) -> bool:
        """Whether no two faces share a vertex."""
        return self._timed("vertex_use", is_soup, self.faces)

    @cached_property
    def _areas(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        return self._timed("areas", face_areas, self.vertices, self.faces)

    @cached_property
    def _components(self) -> tuple[Components, int]:
        return self._timed("components", find_components, self.mesh, self.area)

    def _timed(self, stage: str, compute: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        start = time.perf_counter()
        result = compute(*args, **kwargs)
        self.timings_ms[stage] = (time.perf_counter() - start) * 1e3
        return result

    @property
    def referenced(self) -> NDArray[np.bool_]:
        """(V,) whether a face without a repeated index uses the vertex."""
        return np.asarray(self.fans.fans_per_vertex > 0)

    @property
    def offending(self) -> Offending:
        """The elements that the audit reports, by the keys of its counts."""
        mesh, fans = self.mesh, self.fans
        # Crowded edges are edges with more than two faces. A two-face edge is flipped if both half-edges
        # start at the same vertex.
        crowded = np.flatnonzero(mesh.multiplicity > 2)
        first, second = mesh.two_face_halfedges
        flipped = np.flatnonzero(mesh.multiplicity == 2)[mesh.origin[first] == mesh.origin[second]]
        no_area = has_no_area(self.area, self.finite, mesh.repeated_index)
        return Offending(
            edges={
                "nonmanifold_edges": crowded,
                "boundary_edges": self.boundary.edges,
                "inconsistent_winding_edges": flipped,
            },
            vertices={
                "nonmanifold_vertices": np.flatnonzero(fans.fans_per_vertex > 1),
                "multifan_vertices": np.flatnonzero(fans.groups_per_vertex > 1),
                "nonmanifold_edge_endpoints": np.unique(mesh.edge_vertices[crowded]).astype(np.intp),
                "unreferenced_vertices": np.flatnonzero(~self.referenced),
            },
            faces={
                "repeated_index_faces": np.flatnonzero(mesh.repeated_index),
                "zero_area_faces": np.flatnonzero(no_area),
                "nonfinite_faces": np.flatnonzero(~self.finite),
                "duplicate_faces": np.flatnonzero(self.duplicate),
            },
        )


def find_components(mesh: HalfEdgeMesh, area: NDArray[np.float64]) -> tuple[Components, int]:
    """Return the components joined across all edges. Also return the number of components joined across
    two-face edges only.
    """
    # `compact` (F,) contains consecutive indices of the faces without a repeated index.
    proper = np.flatnonzero(~mesh.repeated_index)
    compact = np.full(mesh.face_count, NONE, mesh.faces.dtype)
    compact[proper] = np.arange(len(proper), dtype=mesh.faces.dtype)
    first, second = (compact[face_of(h)] for h in mesh.two_face_halfedges)
    # Join faces across two-face edges first. Then join the resulting parts across edges with more faces.
    two_face, part = label_components(len(proper), first, second)
    first, second = (part[compact[face_of(h)]] for h in mesh.chained_halfedges)
    count, merged = label_components(two_face, first, second)
    label = merged[part]
    face_component = np.full(mesh.face_count, NONE, mesh.faces.dtype)
    face_component[proper] = label
    sizes = np.bincount(label, minlength=count)
    areas = sum_areas(area[proper], label, count)
    return Components(face_component, sizes, areas), two_face
