"""Make attempts in child processes; one that hangs, crashes or takes too much costs itself alone."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from msb.base.children import run_apart
from msb.trial.mesh import TriedMesh
from msb.trial.registry import TASKS
from msb.trial.task import Attempted, Made
from msb.trial.units import Unit

if TYPE_CHECKING:
    from msb.base.limits import Limits
    from msb.trial.task import Attempt, Task


def run_attempt(
    task: Task, attempt: Attempt, mesh: TriedMesh, arrays: Mapping[str, NDArray[Any]], limits: Limits
) -> Attempted:
    """Return what became of an attempt at a task; `arrays` are those that `Task.prepare` made."""
    unit = None if attempt.any_unit else Unit.of(mesh)
    given = mesh if unit is None else unit.enter(mesh)
    further = arrays if unit is None else unit.enter_points(arrays)
    reply = run_apart(work, f"{task.name} {attempt.library}", {**_joined({"mesh": given}, further)}, limits)
    if reply.ended_by == "time":
        return Attempted(None, f"{reply.why} (--seconds gives more)", "time", reply.seconds)
    known = None if reply.seconds is None else version(attempt.library)
    if reply.why:
        return Attempted(None, reply.why, reply.ended_by, reply.seconds, known)
    try:
        made = Made(reply.data, *_parted(reply.arrays))
    except ValueError as error:
        return Attempted(None, str(error), "crash")
    return Attempted(
        made if unit is None else unit.leave(made, task.powers), seconds=reply.seconds, version=known
    )


def work(word: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Make the attempt "TASK LIBRARY"; runs in the child process."""
    name, library = word.split()
    task = TASKS[name]
    attempt = next(one for one in (*task.attempts, *task.instead) if one.library == library)
    meshes, further = _parted(arrays)
    made = attempt.work(meshes["mesh"], task.parameters, further)
    return made.numbers, _joined(made.meshes, made.arrays)


def _joined(meshes: Mapping[str, TriedMesh], arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of meshes, as MESH.KEY, and further ones."""
    parts = {f"{name}.{key}": array for name, mesh in meshes.items() for key, array in mesh.arrays().items()}
    return {**parts, **arrays}


def _parted(
    arrays: Mapping[str, NDArray[Any]],
) -> tuple[dict[str, TriedMesh], dict[str, NDArray[Any]]]:
    """Return the meshes and the further arrays that `_joined` put together."""
    parts: dict[str, dict[str, NDArray[Any]]] = {}
    further: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        mesh, dot, key = name.partition(".")
        if dot:
            parts.setdefault(mesh, {})[key] = array
        else:
            further[name] = array
    return {mesh: TriedMesh.of(mesh, own) for mesh, own in parts.items()}, further
