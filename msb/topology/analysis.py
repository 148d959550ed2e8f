"""Everything the audit derives from a mesh, element by element: the audit counts it, viewers draw it."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from msb.base.soup import is_soup
from msb.topology.components import label_components
from msb.topology.faces import added_areas, extra_duplicates, face_areas, has_no_area
from msb.topology.fans import Boundary, Fans, find_boundary, find_fans
from msb.topology.halfedge import NONE, HalfEdgeMesh, build_half_edges, face_of

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Components:
    """Edge-connected components over the faces without a repeated index.

    `face_component` (F,) is NONE for repeated-index rows; `sizes` (n,) are numbers of faces, `areas` (n,)
    float64 in squared length units.
    """

    face_component: NDArray[Any]
    sizes: NDArray[Any]
    areas: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of components."""
        return len(self.sizes)

    def largest(self) -> int | None:
        """Return the component with most faces; ties go to the larger area, then to the smallest face index.

        Components are numbered by their smallest face, so the last tie falls to the lowest number.
        """
        if self.count == 0:
            return None
        most = np.flatnonzero(self.sizes == self.sizes.max())
        return int(most[np.argmax(self.areas[most])])


@dataclass(frozen=True)
class Offending:
    """Key of the JSON -> (n,) integers: the numbers of the elements behind the audit's counts, ascending."""

    edges: dict[str, NDArray[Any]]
    vertices: dict[str, NDArray[Any]]
    faces: dict[str, NDArray[Any]]


class Analysis:
    """A mesh with its half-edges, fans, boundary, components and per-face properties.

    It takes arrays that `mesh_arrays` has checked. NumPy and SciPy make each part when it is first asked for;
    `timings_ms` then says how long that took.
    """

    def __init__(self, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
        self.vertices = vertices
        self.faces = faces
        self.timings_ms: dict[str, float] = {}

    @cached_property
    def mesh(self) -> HalfEdgeMesh:
        """The half-edge structure."""
        return self._made("half_edges", build_half_edges, self.faces, len(self.vertices))

    @cached_property
    def fans(self) -> Fans:
        """The fans around every vertex."""
        return self._made("fans", find_fans, self.mesh)

    @cached_property
    def boundary(self) -> Boundary:
        """The boundary loops and chains."""
        return self._made("boundary", find_boundary, self.mesh, self.fans)

    @property
    def area(self) -> NDArray[np.float64]:
        """(F,) area of each face, 0 where it is not finite; squared length units."""
        return self._areas[0]

    @property
    def finite(self) -> NDArray[np.bool_]:
        """(F,) whether the area of each face is finite."""
        return self._areas[1]

    @property
    def components(self) -> Components:
        """The components across all shared edges."""
        return self._components[0]

    @property
    def two_face_components(self) -> int:
        """Number of components when faces join across two-face edges only."""
        return self._components[1]

    @cached_property
    def duplicate(self) -> NDArray[np.bool_]:
        """(F,) whether each face repeats an earlier one."""
        return self._made("duplicates", extra_duplicates, self.faces)

    @cached_property
    def soup(self) -> bool:
        """Whether no vertex is used by two faces."""
        return self._made("vertex_use", is_soup, self.faces)

    @cached_property
    def _areas(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        return self._made("areas", face_areas, self.vertices, self.faces)

    @cached_property
    def _components(self) -> tuple[Components, int]:
        return self._made("components", find_components, self.mesh, self.area)

    def _made(self, stage: str, make: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        start = time.perf_counter()
        made = make(*args, **kwargs)
        self.timings_ms[stage] = (time.perf_counter() - start) * 1e3
        return made

    @property
    def referenced(self) -> NDArray[np.bool_]:
        """(V,) whether a face without a repeated index uses the vertex."""
        return np.asarray(self.fans.fans_per_vertex > 0)

    @property
    def offending(self) -> Offending:
        """The elements of this mesh that a person would want to see, by the names of the audit's counts."""
        mesh, fans = self.mesh, self.fans
        crowded = np.flatnonzero(mesh.multiplicity > 2)
        one, other = mesh.two_face_halfedges
        flips = np.flatnonzero(mesh.multiplicity == 2)[mesh.origin[one] == mesh.origin[other]]
        no_area = has_no_area(self.area, self.finite, mesh.repeated_index)
        return Offending(
            edges={
                "nonmanifold_edges": crowded,
                "boundary_edges": self.boundary.edges,
                "inconsistent_winding_edges": flips,
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
    """Return the components across all shared edges, and how many there are across two-face edges only."""
    proper = np.flatnonzero(~mesh.repeated_index)
    compact = np.full(mesh.face_count, NONE, mesh.faces.dtype)
    compact[proper] = np.arange(len(proper), dtype=mesh.faces.dtype)
    one, other = (compact[face_of(h)] for h in mesh.two_face_halfedges)
    two_face, part = label_components(len(proper), one, other)
    one, other = (part[compact[face_of(h)]] for h in mesh.chained_halfedges)
    count, whole = label_components(two_face, one, other)
    label = whole[part]
    face_component = np.full(mesh.face_count, NONE, mesh.faces.dtype)
    face_component[proper] = label
    sizes = np.bincount(label, minlength=count)
    areas = added_areas(area[proper], label, count)
    return Components(face_component, sizes, areas), two_face
