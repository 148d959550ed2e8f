"""Repair steps of peer libraries, in a child process with limits of time and memory."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import run_in_child
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import Unsupported
from msb.topology.faces import names_vertex_twice
from msb.topology.steps.change import Change, unchanged

# The new faces, the vertex map and the face map.
Repaired = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]


@dataclass(frozen=True)
class PeerStep:
    """A repair step of a peer library. The function `work` takes vertices and faces, and returns the new
    faces, the vertex map and the face map."""

    module: str
    distribution: str
    work: Callable[[NDArray[np.float64], NDArray[np.int64]], Repaired]


def cut_by_libigl(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Repaired:
    """Return the result of `igl.split_nonmanifold`. This function also cuts edges where the winding flips."""
    import igl

    new, vertex_map = igl.split_nonmanifold(faces)
    return new, vertex_map.reshape(-1), np.arange(len(faces))


def drop_by_pymeshlab(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Repaired:
    """Repair a mesh with PyMeshLab: first its edges (Remove Faces), then its vertices. Return the faces that
    remain.

    The index of each vertex and face is stored as a scalar attribute. PyMeshLab's filters keep this
    attribute.
    """
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    numbers = (np.arange(len(rows), dtype=np.float64) for rows in (vertices, faces))
    mesh = pymeshlab.Mesh(vertices, faces, v_scalar_array=next(numbers), f_scalar_array=next(numbers))
    meshes.add_mesh(mesh)
    meshes.meshing_repair_non_manifold_edges(method="Remove Faces")
    meshes.meshing_repair_non_manifold_vertices()
    left = meshes.current_mesh()
    left.compact()
    maps = (
        np.rint(scalars).astype(np.int64)
        for scalars in (left.vertex_scalar_array(), left.face_scalar_array())
    )
    return left.face_matrix().astype(np.int64), next(maps), next(maps)


# Maps names of the form PEER-STEP to repair steps of peers.
PEER_STEPS: dict[str, PeerStep] = {
    "igl-cut": PeerStep("igl", "libigl", cut_by_libigl),
    "pymeshlab-drop": PeerStep("pymeshlab", "pymeshlab", drop_by_pymeshlab),
}


def repair_by_peer(peer: str, step: str, points: NDArray[Any], faces: NDArray[Any], limits: Limits) -> Change:
    """Return the change made by step `step` of peer `peer`. `PEER_STEPS` maps names of the form PEER-STEP to
    repair steps.

    Faces with a repeated index are removed.
    """
    name = f"{peer}-{step}"
    chosen = PEER_STEPS[name]
    need_extra("crosscheck", chosen.module, what=f"{step} by {peer}")
    proper = np.flatnonzero(~names_vertex_twice(faces))
    if len(proper) == 0:  # some peers abort on empty meshes
        return unchanged(faces, len(points))
    given = {"vertices": points.astype(np.float64), "faces": faces[proper].astype(np.int64)}
    reply = run_in_child(repair, name, given, limits)
    if reply.why:
        raise Unsupported("PEER_FAILED", f"{step} by {peer}: {reply.why}")
    new, vertex_map, face_map = (reply.arrays[key] for key in ("faces", "vertex_map", "face_map"))
    if not (vertex_map[new] == faces[proper][face_map]).all():
        raise Unsupported(
            "PEER_FAILED", f"{step} by {peer} failed: the result has faces with reordered corners"
        )
    limit = "" if limits.limits_memory else "; this system cannot limit memory"
    notes = (f"by {peer} {version(chosen.distribution)}{limit}",)
    turned = np.zeros(len(new), bool)
    return Change(new.astype(faces.dtype), vertex_map, proper[face_map], turned, notes=notes)


def repair(name: str, mesh: Mapping[str, NDArray[Any]]) -> tuple[None, dict[str, NDArray[np.int64]]]:
    """Run the step `name`. This function runs in the child process."""
    results = PEER_STEPS[name].work(mesh["vertices"], mesh["faces"])
    keys = ("faces", "vertex_map", "face_map")
    return None, {key: np.asarray(array, np.int64) for key, array in zip(keys, results, strict=True)}
