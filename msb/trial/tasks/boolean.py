"""Boolean operation by manifold3d: a box that covers half of the mesh is subtracted."""

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import signed_volume
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings
from msb.trial.task import Attempt, Judgement, Numbers, Output, Outputs, Task
from msb.trial.tasks.decimate import draw_side_by_side
from msb.trial.tasks.solid import INWARDS, build_solid

# Largest relative difference between the volume of the mesh and the sum of its parts. In a correct boolean
# operation, the volumes differ only by rounding.
TOLERANCE = 0.01


def _work(mesh: TrialMesh, _: Arrays) -> Output:
    """Subtract the box, and measure the volumes of both parts."""
    import manifold3d

    solid, numbers = build_solid(mesh)
    if solid is None:
        return Output(numbers)
    # Along the longest side, the box covers half of the mesh. Along the other sides, the box covers the whole
    # mesh and a margin.
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
    return Output(numbers, {"left": TrialMesh(points, faces, _nearest_colors(mesh, points))})


def _nearest_colors(mesh: TrialMesh, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the colour (n, 3) of the vertex of `mesh` nearest to each point."""
    from scipy.spatial import cKDTree

    used = np.unique(mesh.faces)
    _, nearest = cKDTree(mesh.vertices[used]).query(points)
    return mesh.colors[used[np.asarray(nearest, np.int64)]]


def _judge(_: TrialMesh, outputs: Outputs, __: Renderings) -> Judgement:
    numbers = outputs["manifold3d"].numbers
    if not numbers["accepted_merged"]:
        return Judgement("fails", f"manifold3d rejects the mesh: {numbers['status']}", numbers)
    whole, left, taken = (numbers[name] for name in ("volume", "volume_left", "volume_taken"))
    size = max(abs(whole), abs(left) + abs(taken))  # Volumes with opposite winding may cancel each other.
    error = abs(left + taken - whole) / size if size else 1.0
    numbers = {**numbers, "volume_error": error}
    if error > TOLERANCE:
        return Judgement(
            "fails", f"the total volume of the parts differs from the mesh by {100 * error:.0f} %", numbers
        )
    if not numbers["accepted"]:
        return Judgement("care", "manifold3d accepts the mesh only after merging vertices", numbers)
    if whole < 0:
        return Judgement("care", INWARDS, numbers)
    return Judgement("works", None, numbers)


def _summarize(numbers: Numbers) -> str:
    if "volume_left" not in numbers:
        return ""
    left, taken = abs(numbers["volume_left"]), abs(numbers["volume_taken"])
    share = left / ((left + taken) or 1.0)
    return f"{numbers['faces_left']:,} faces remain, {100 * share:.0f} % of the volume"


TASKS = (
    Task(
        "boolean",
        "Boolean with a box",
        (Attempt("manifold3d", ("manifold3d",), _work),),
        _judge,
        _summarize,
        powers={"volume": 3, "volume_left": 3, "volume_taken": 3},
        picture=draw_side_by_side,
    ),
)
