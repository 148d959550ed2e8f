"""A boolean with a box by manifold3d: the half of a mesh that the box takes away, and the one it leaves."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import signed_volume
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Numbers, Task
from msb.trial.tasks.decimate import beside
from msb.trial.tasks.solid import INWARDS, offer

TOLERANCE = 0.01  # largest relative error of a volume


def _work(mesh: TriedMesh, _: Arrays) -> Made:
    import manifold3d

    solid, numbers = offer(mesh)
    if solid is None:
        return Made(numbers)
    used = mesh.vertices[mesh.faces].reshape(-1, 3).astype(np.float64)
    low, high = used.min(axis=0), used.max(axis=0)
    margin = 0.1 * float((high - low).max())
    size = high - low + 2 * margin
    axis = int(np.argmax(high - low))
    size[axis] = (high - low)[axis] / 2 + margin
    box = manifold3d.Manifold.cube(tuple(size)).translate(tuple(low - margin))
    left, taken = solid - box, solid ^ box
    numbers |= {
        "volume": signed_volume(mesh.vertices, mesh.faces),
        "volume_left": float(left.volume()),
        "volume_taken": float(taken.volume()),
        "faces_left": int(left.num_tri()),
    }
    rest = left.to_mesh()
    points = np.ascontiguousarray(rest.vert_properties[:, :3], np.float32)
    faces = np.asarray(rest.tri_verts, np.int64)
    return Made(numbers, {"left": TriedMesh(points, faces, _nearest_colors(mesh, points))})


def _nearest_colors(mesh: TriedMesh, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the colour of the nearest vertex: the library keeps none."""
    from scipy.spatial import cKDTree

    used = np.unique(mesh.faces)
    _, nearest = cKDTree(mesh.vertices[used]).query(points)
    return mesh.colors[used[np.asarray(nearest, np.int64)]]


def _judge(_: TriedMesh, made: Mapping[str, Made], __: Look) -> Judgement:
    numbers = made["manifold3d"].numbers
    if not numbers["accepted_merged"]:
        return Judgement("fails", f"manifold3d refuses it: {numbers['status']}", numbers)
    whole, left, taken = (numbers[name] for name in ("volume", "volume_left", "volume_taken"))
    size = max(abs(whole), abs(left) + abs(taken))  # bodies wound both ways may cancel each other
    error = abs(left + taken - whole) / size if size else 1.0
    numbers = {**numbers, "volume_error": error}
    if error > TOLERANCE:
        return Judgement(
            "fails", f"the parts have {100 * error:.0f} % more or less volume than the whole", numbers
        )
    if not numbers["accepted"]:
        return Judgement("care", "manifold3d takes it only once it has merged vertices", numbers)
    if whole < 0:
        return Judgement("care", INWARDS, numbers)
    return Judgement("works", None, numbers)


def _says(numbers: Numbers) -> str:
    if "volume_left" not in numbers:
        return ""
    left, taken = abs(numbers["volume_left"]), abs(numbers["volume_taken"])
    share = left / ((left + taken) or 1.0)
    return f"{numbers['faces_left']:,} faces left, {100 * share:.0f} % of the volume"


TASKS = (
    Task(
        "boolean",
        "Boolean with a box",
        (Attempt("manifold3d", ("manifold3d",), _work),),
        _judge,
        _says,
        powers={"volume": 3, "volume_left": 3, "volume_taken": 3},
        picture=beside,
    ),
)
