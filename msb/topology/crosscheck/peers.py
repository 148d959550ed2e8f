"""Measure a mesh with each peer library. Only this module and `repairs.py` import the peers.

Every function takes a mesh with valid indices and at least one face. The function returns the peer's answers
under the names that `expected.py` uses. `ask_peers` runs the functions in separate processes, because peers
print, hang or crash on some faulty meshes. The tested versions are libigl 2.6.3, PyMeshLab 2025.7.post1,
manifold3d 3.5.4, trimesh 5.2.0, NetworkX 3.6.1 and usd-validation-nvidia 1.22.0 with usd-core 26.8.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import run_in_children
from msb.base.limits import Limits

# Number of peers that run at the same time. Each process uses one core and several times the memory of the
# mesh.
AT_ONCE = 2
Answer = bool | int | float | None
Answers = dict[str, Answer]


@dataclass(frozen=True)
class Peer:
    """A peer library, and the function that measures a mesh with it.

    The function takes (V, 3) float64 vertices and (F, 3) int64 faces. Larger meshes than `max_faces` would
    take too much time or memory.
    """

    module: str
    distribution: str
    ask: Callable[[NDArray[np.float64], NDArray[np.int64]], Answers]
    max_faces: int | None = None


def ask_libigl(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Answers:
    """Return libigl's counts."""
    import igl

    # libigl calls an unreferenced vertex non-manifold if its index is below the largest used index. Remove
    # such vertices first.
    used, compact = np.unique(faces, return_inverse=True)
    multifan = used[~igl.is_vertex_manifold(compact.reshape(-1, 3))]
    _, edges, _, offsets, _ = igl.unique_edge_map(faces)
    multiplicity = np.diff(offsets)
    endpoints = np.unique(edges[multiplicity > 2])
    components, component = igl.facet_components(faces)
    answers: Answers = {
        "edges": len(igl.edges(faces)),
        "boundary_edges": len(igl.boundary_facets(faces)[0]),
        "manifold_edges": int(np.count_nonzero(multiplicity == 2)),
        "nonmanifold_edges": int(np.count_nonzero(multiplicity > 2)),
        "max_edge_faces": int(multiplicity.max()),
        "nonmanifold_edge_endpoints": len(endpoints),
        "multifan_vertices": len(multifan),
        "nonmanifold_vertices": len(np.union1d(multifan, endpoints)),
        "components": int(components),
        "largest_component_faces": int(np.bincount(component).max()),
        "euler_characteristic": int(igl.euler_characteristic(faces)),
        "total_area": _finite_or_none(igl.doublearea(vertices, faces).sum() / 2),
    }
    if len(multifan) == len(endpoints) == 0:
        answers["boundary_loops"] = len(igl.boundary_loop_all(faces))
    return answers


def ask_pymeshlab(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Answers:
    """Return PyMeshLab's topological measures.

    The measures are correct only in a fresh process. From the fifth call in a process on,
    `non_two_manifold_edges` counts faces at such edges, not the edges themselves. A row (a, b, a) would put
    PyMeshLab into an endless loop. Such rows are rotated to (a, a, b).
    """
    import pymeshlab

    rows = faces.copy()
    ends_alike = rows[:, 0] == rows[:, 2]
    rows[ends_alike] = np.roll(rows[ends_alike], 1, axis=1)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertices, rows))
    measures = meshes.get_topological_measures()
    answers: Answers = {
        "vertices": int(measures["vertices_number"]),
        "faces": int(measures["faces_number"]),
        "unreferenced_vertices": int(measures["unreferenced_vertices"]),
        "edges": int(measures["edges_number"]),
        "boundary_edges": int(measures["boundary_edges"]),
        "nonmanifold_edges": int(measures["non_two_manifold_edges"]),
        "off_edge_vertices": int(measures["non_two_manifold_vertices"]),
        "components": int(measures["connected_components_number"]),
    }
    if measures["number_holes"] >= 0:  # The value is -1 for meshes that are not two-manifold.
        answers["boundary_loops"] = int(measures["number_holes"])
    return answers


def ask_manifold3d(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Answers:
    """Return whether manifold3d accepts the faces as a solid.

    manifold3d also rejects coordinates that are not finite in float32. This function tests connectivity only,
    so all coordinates are set to zero. manifold3d crashes on some meshes with half-edges that have no
    partner.
    """
    import manifold3d

    mesh = manifold3d.Mesh(
        vert_properties=np.zeros((len(vertices), 3), np.float32), tri_verts=faces.astype(np.uint32)
    )
    return {"closed_oriented": manifold3d.Manifold(mesh).status() == manifold3d.Error.NoError}


def ask_trimesh(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Answers:
    """Return trimesh's counts and flags."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    edges = len(mesh.edges_unique)
    multiplicity = np.bincount(mesh.edges_unique_inverse, minlength=edges)
    graph: Any = trimesh.graph  # untyped
    label = graph.connected_component_labels(mesh.face_adjacency, node_count=len(faces))
    return {
        "referenced_vertices": int(np.count_nonzero(mesh.referenced_vertices)),
        "edges": edges,
        "boundary_edges": int(np.count_nonzero(multiplicity == 1)),
        "manifold_edges": int(np.count_nonzero(multiplicity == 2)),
        "nonmanifold_edges": int(np.count_nonzero(multiplicity > 2)),
        "max_edge_faces": int(multiplicity.max()),
        "components_manifold_edges": int(label.max()) + 1,
        "bodies": int(mesh.body_count),
        "euler_characteristic": int(mesh.euler_number),
        "total_area": _finite_or_none(mesh.area),
        "winding_consistent": bool(mesh.is_winding_consistent),
        "closed": bool(mesh.is_watertight),
    }


def ask_networkx(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Answers:
    """Return the counts of NetworkX. The graphs are built in plain Python and follow our definitions.

    The vertex graph gives the edges. The face graph connects consecutive faces of an edge, and gives the
    components. The third graph is the union of all vertex links. In this graph, the node (v, w) is the end v
    of the edge v-w. At each of its corners, a face connects two nodes of this graph.
    """
    import networkx

    rows = [row for row in faces.tolist() if len(set(row)) == 3]
    faces_of: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(rows):
        for u, w in ((a, b), (b, c), (c, a)):
            faces_of.setdefault((u, w) if u < w else (w, u), []).append(face)
    through_all = networkx.empty_graph(len(rows))
    through_all.add_edges_from(pair for group in faces_of.values() for pair in pairwise(group))
    through_two = networkx.empty_graph(len(rows))
    through_two.add_edges_from(group for group in faces_of.values() if len(group) == 2)
    sizes = [len(part) for part in networkx.connected_components(through_all)]
    crowded = networkx.Graph(edge for edge, group in faces_of.items() if len(group) > 2)
    multifan = _find_split_links(rows, len(vertices))
    return {
        "edges": networkx.Graph(faces_of.keys()).number_of_edges(),
        "nonmanifold_edges": crowded.number_of_edges(),
        "nonmanifold_edge_endpoints": crowded.number_of_nodes(),
        "multifan_vertices": len(multifan),
        "nonmanifold_vertices": len(multifan | set(crowded)),
        "components": len(sizes),
        "largest_component_faces": max(sizes, default=0),
        "components_manifold_edges": networkx.number_connected_components(through_two),
    }


def _find_split_links(rows: Iterable[list[int]], vertex_count: int) -> set[int]:
    """Return the vertices whose link consists of several parts."""
    import networkx

    links = networkx.Graph()
    for a, b, c in rows:
        for v, u, w in ((a, b, c), (b, c, a), (c, a, b)):
            links.add_edge(v * vertex_count + u, v * vertex_count + w)
    pieces: dict[int, int] = {}
    for piece in networkx.connected_components(links):
        v = next(iter(piece)) // vertex_count
        pieces[v] = pieces.get(v, 0) + 1
    return {v for v, count in pieces.items() if count > 1}


def ask_nvidia(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Answers:
    """Return the counts that NVIDIA's ManifoldChecker reports for a USD stage with the mesh.

    The checker returns a sentence for each fault, and nothing for a valid mesh.
    """
    from pxr import Usd, UsdGeom, Vt
    from usd_validation_nvidia import ManifoldChecker, ValidationEngine

    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    # The checker ignores coordinates.
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.zeros((len(vertices), 3), np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).reshape(-1)))
    engine = ValidationEngine(init_rules=False)
    engine.enable_rule(ManifoldChecker)
    answers: Answers = {"nonmanifold_edges": 0, "nonmanifold_vertices": 0, "winding_consistent": True}
    for issue in engine.validate(stage).issues():
        count = re.fullmatch(r"(\d+) (edges|vertices) are non-manifold\.", issue.message)
        if count:
            answers[f"nonmanifold_{count[2]}"] = int(count[1])
        elif issue.message == "The face winding is not consistent.":
            answers["winding_consistent"] = False
        else:
            raise ValueError(issue.message)
    return answers


def _finite_or_none(value: Any) -> float | None:
    """Return a finite float. Values that are not finite floats become None, because JSON has no NaN."""
    number = float(value)
    return number if math.isfinite(number) else None


# The peers by name, in the order of reports.
PEERS: dict[str, Peer] = {
    "libigl": Peer("igl", "libigl", ask_libigl),
    "PyMeshLab": Peer("pymeshlab", "pymeshlab", ask_pymeshlab),
    "manifold3d": Peer("manifold3d", "manifold3d", ask_manifold3d),
    "trimesh": Peer("trimesh", "trimesh", ask_trimesh),
    # At this limit, NetworkX takes about 10 s and 0.9 GB for its Python objects.
    "NetworkX": Peer("networkx", "networkx", ask_networkx, max_faces=200_000),
    # NetworkX takes 10 s and 0.9 GB per million faces.
    "NVIDIA": Peer("usd_validation_nvidia", "usd-validation-nvidia", ask_nvidia, max_faces=2_000_000),
}


def ask_peers(
    names: Sequence[str], vertices: NDArray[Any], faces: NDArray[Any], timeout: float
) -> dict[str, Answers | str]:
    """Return each peer's answers about a mesh with at least one face, or the reason for a failure.

    Each peer runs in a separate process for at most `timeout` seconds. A crash or a hang therefore affects
    only this peer.
    """
    mesh = {"vertices": vertices.astype(np.float64), "faces": faces.astype(np.int64)}
    replies = run_in_children(ask, names, mesh, Limits(timeout, None), at_once=AT_ONCE)
    return {name: reply.why or reply.data for name, reply in replies.items()}


def ask(peer: str, mesh: Mapping[str, NDArray[Any]]) -> tuple[Answers, dict[str, NDArray[Any]]]:
    """Measure a mesh with the peer `peer`. This function runs in the child process."""
    return PEERS[peer].ask(mesh["vertices"], mesh["faces"]), {}
