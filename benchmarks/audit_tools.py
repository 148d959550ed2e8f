"""The tools of `benchmarks.audit`: our audit, a lower bound, and the peers.

All are timed on the same two arrays. A tool is a function of vertices (V, 3) float32 and faces (F, 3) int32
that returns the timed work. Preparation (a mesh object, wider integers) is not timed. The work returns its
answers. Answers with the same definition have the same name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    Answers = dict[str, float]
    Tool = Callable[[NDArray[Any], NDArray[Any]], Callable[[], Answers]]

WHAT = {
    "msb": "the whole audit: every count, metric, variant and sample",
    "msb, NumPy": "the same by the NumPy twin",
    "pymeshlab": "get_topological_measures only, without adding the mesh",
    "pymeshlab+mesh": "the same, including adding the mesh",
    "trimesh": "edges, adjacency, two-face components, areas",
    "meshlib": "mesh, components, holes, area; splits vertices to be manifold",
    "open3d": "non-manifold edges and vertices, components",
    "igl": "edges, boundary, vertex manifoldness, components, areas",
    "scatter": "lower bound: one random scatter of 3F int32",
}
PACKAGES = ("numpy", "scipy", "pyopencl", "libigl", "pymeshlab", "trimesh", "meshlib", "open3d-cpu")


def ours(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare our audit."""
    import msb

    def work() -> Answers:
        audit = msb.audit(vertices, faces)
        c = audit.counts
        return {
            "edges": c.edges,
            "boundary_edges": c.boundary_edges,
            "nonmanifold_edges": c.nonmanifold_edges,
            "components": c.components,
            "components_two_face": c.components_manifold_edges,
            "nm_vertices_off_nm_edges": c.nonmanifold_vertices - c.nonmanifold_edge_endpoints,
            "multifan_vertices": c.multifan_vertices,
            "area": round(audit.metrics.total_area, 6),
        }

    return work


def by_numpy(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare our audit without the kernels."""
    from msb.topology import dispatch

    dispatch.FEWEST_FACES = len(faces) + 1
    return ours(vertices, faces)


def pymeshlab(vertices: NDArray[Any], faces: NDArray[Any], *, add: bool = False) -> Callable[[], Answers]:
    """Prepare PyMeshLab. `add` includes the copy of the mesh in the time."""
    import pymeshlab as library

    def mesh_set() -> Any:
        meshes = library.MeshSet()
        meshes.add_mesh(library.Mesh(vertices.astype(np.float64), faces))
        return meshes

    ready = None if add else mesh_set()

    def work() -> Answers:
        measures = (ready or mesh_set()).get_topological_measures()
        return {
            "edges": measures["edges_number"],
            "boundary_edges": measures["boundary_edges"],
            "components": measures["connected_components_number"],
            "nm_vertices_off_nm_edges": measures["non_two_manifold_vertices"],
        }

    return work


def pymeshlab_with_mesh(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare PyMeshLab, including the copy of the mesh in the time."""
    return pymeshlab(vertices, faces, add=True)


def igl(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare libigl."""
    import igl as library

    points, triangles = vertices.astype(np.float64), faces.astype(np.int64)

    def work() -> Answers:
        edges = library.edges(triangles)
        boundary = library.boundary_facets(triangles)[0]
        manifold = np.asarray(library.is_vertex_manifold(triangles))
        components = library.facet_components(triangles)
        count = int(np.max(components[1] if isinstance(components, tuple) else components)) + 1
        return {
            "edges": len(edges),
            "boundary_edges": len(boundary),
            "components": count,
            "multifan_vertices": int(np.count_nonzero(~manifold)),
            "area": round(float(library.doublearea(points, triangles).sum() / 2), 6),
        }

    return work


def trimesh(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare trimesh without its default merging of vertices."""
    import trimesh as library

    mesh = library.Trimesh(vertices.astype(np.float64), faces.astype(np.int64), process=False)

    def work() -> Answers:
        uses = np.bincount(mesh.edges_unique_inverse)
        labels = library.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
        return {
            "edges": len(mesh.edges_unique),
            "boundary_edges": int(np.count_nonzero(uses == 1)),
            "components_two_face": int(labels.max()) + 1,
            "area": round(float(mesh.area), 6),
        }

    return work


def meshlib(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare MeshLib.

    It spends most of its time on building the mesh object, which then gives the counts.
    """
    from meshlib import mrmeshnumpy, mrmeshpy

    points = vertices.astype(np.float64)

    def work() -> Answers:
        mesh = mrmeshnumpy.meshFromFacesVerts(faces, points)
        mrmeshpy.getAllComponents(mesh)
        mesh.topology.findNumHoles()
        return {"area": round(float(mesh.area()), 6)}

    return work


def open3d(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare Open3D."""
    import open3d as library

    mesh = library.geometry.TriangleMesh(
        library.utility.Vector3dVector(vertices.astype(np.float64)), library.utility.Vector3iVector(faces)
    )

    def work() -> Answers:
        edges = mesh.get_non_manifold_edges(allow_boundary_edges=True)
        fans = mesh.get_non_manifold_vertices()
        _, sizes, _ = mesh.cluster_connected_triangles()
        return {"nonmanifold_edges": len(edges), "multifan_vertices": len(fans), "components": len(sizes)}

    return work


def scatter(vertices: NDArray[Any], faces: NDArray[Any]) -> Callable[[], Answers]:
    """Prepare the lower bound, which writes 3F int32 values to random places."""
    place = np.random.default_rng(0).permutation(faces.size)
    values, out = np.arange(faces.size, dtype=np.int32), np.zeros(faces.size, np.int32)

    def work() -> Answers:
        out[place] = values
        return {}

    return work


TOOLS: dict[str, Tool] = {
    "msb": ours,
    "scatter": scatter,
    "pymeshlab": pymeshlab,
    "pymeshlab+mesh": pymeshlab_with_mesh,
    "trimesh": trimesh,
    "msb, NumPy": by_numpy,
    "meshlib": meshlib,
    "igl": igl,
    "open3d": open3d,
}
ONCE_FROM = {"igl": 500_000, "open3d": 0, "meshlib": 500_000, "msb, NumPy": 500_000, "trimesh": 5_000_000}
"""From this number of faces on, a slow tool runs in the first round only."""
AT_MOST = {
    "igl": 5e6,
    "open3d": 2e6,
    "meshlib": 5e6,
    "msb, NumPy": 5e6,
    "pymeshlab+mesh": 5e6,
    "trimesh": 5e6,
}
"""Largest number of faces for a slow tool, unless --all is given."""
