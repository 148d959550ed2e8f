"""Steps of a repair done by a peer library, in a child process with limits of time and memory."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import leaving, shared_folder
from msb.base.extras import need_extra
from msb.base.npz import write_npy
from msb.errors import Unsupported
from msb.topology.crosscheck.children import leave_mesh, run_children
from msb.topology.faces import names_vertex_twice
from msb.topology.steps.change import Change, unchanged

if TYPE_CHECKING:
    from msb.topology.crosscheck.peers import Answers

    Repaired = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]

_RESULT = ("faces", "vertex_map", "face_map")


@dataclass(frozen=True)
class PeerStep:
    """A step of a peer: `work` takes vertices and faces and returns new faces, vertex map and face map."""

    module: str
    distribution: str
    work: Callable[[NDArray[np.float64], NDArray[np.int64]], Repaired]


def cut_by_libigl(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Repaired:
    """Return what `igl.split_nonmanifold` makes of the faces; it also cuts where the winding flips."""
    import igl

    new, vertex_map = igl.split_nonmanifold(faces)
    return new, vertex_map.reshape(-1), np.arange(len(faces))


def drop_by_pymeshlab(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Repaired:
    """Return the faces left by PyMeshLab's repair of edges (Remove Faces), then of vertices.

    Vertices and faces carry their numbers as a scalar, which the filters keep.
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


PEER_STEPS: dict[str, PeerStep] = {
    "igl-cut": PeerStep("igl", "libigl", cut_by_libigl),
    "pymeshlab-drop": PeerStep("pymeshlab", "pymeshlab", drop_by_pymeshlab),
}
"""The peers' steps, by PEER-STEP."""


def repair_by_peer(
    peer: str,
    step: str,
    points: NDArray[Any],
    faces: NDArray[Any],
    *,
    seconds: float,
    memory_gib: float,
) -> Change:
    """Return what a peer's step does to a mesh; faces that name a vertex twice are left out.

    Parameters
    ----------
    peer, step : str
        Together a key of `PEER_STEPS`.
    points : (V, 3) floating
    faces : (F, 3) integers
    seconds, memory_gib : float
        Limits of the child process. Only POSIX systems can limit memory.
    """
    name = f"{peer}-{step}"
    need_extra("crosscheck", PEER_STEPS[name].module, what=f"{step} by {peer}")
    proper = np.flatnonzero(~names_vertex_twice(faces))
    if len(proper) == 0:  # some peers abort on no faces
        return unchanged(faces, len(points))
    with shared_folder("msb-repair-") as folder:
        leave_mesh(folder, points, faces[proper])
        (folder / "memory.json").write_text(json.dumps(memory_gib), "utf-8")
        reply = run_children([name], folder, seconds)[name]
        if isinstance(reply, str):
            raise Unsupported("PEER_FAILED", f"{step} by {peer}: {reply}")
        new, vertex_map, face_map = (np.load(folder / f"new-{key}.npy") for key in _RESULT)
    same = (vertex_map[new] == faces[proper][face_map]).all(axis=1)
    if not same.all():
        raise Unsupported("PEER_FAILED", f"{step} by {peer}: its faces have corners in another order")
    limit = "" if reply.answers["memory_limited"] else "; this system sets no limit of memory"
    notes = (f"by {peer} {reply.version}{limit}",)
    turned = np.zeros(len(new), bool)
    return Change(new.astype(faces.dtype), vertex_map, proper[face_map], turned, notes=notes)


def work_in(folder: Path, name: str, vertices: NDArray[Any], faces: NDArray[Any]) -> Answers:
    """Do the step in this process, which is a child, and leave the mesh in `folder`."""
    limited = _limit_memory(float(json.loads((folder / "memory.json").read_text("utf-8"))))
    made = PEER_STEPS[name].work(vertices, faces)
    with leaving():
        for key, array in zip(_RESULT, made, strict=True):
            write_npy(folder / f"new-{key}.npy", np.asarray(array, np.int64))
    return {"memory_limited": limited}


def _limit_memory(gib: float) -> bool:
    """Limit the address space of this process; return whether the system can."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(gib * 2**30),) * 2)
    except (ImportError, OSError, ValueError):
        return False
    return True
