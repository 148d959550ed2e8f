"""Make attempts in child processes; one that hangs, crashes or takes too much costs itself alone.

Libraries have absolute limits: xatlas drops faces of less than 1e-7, and the first errors that
fast-simplification lets pass are of 1e-6. So each is handed the mesh about its middle, in a unit of which the
usual face has an area of 1; with the whole mesh of size 1 a far-flung face would make the others too small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import run_apart
from msb.base.limits import Limits
from msb.topology.faces import face_areas
from msb.trial.mesh import TriedMesh
from msb.trial.registry import TASKS
from msb.trial.task import Attempt, Attempted, Made, Task


def run_attempt(
    task: Task, attempt: Attempt, mesh: TriedMesh, arrays: Mapping[str, NDArray[Any]], limits: Limits
) -> Attempted:
    """Return what became of an attempt at a task; `arrays` are those that `Task.prepare` made."""
    unit = Unit(1.0, np.zeros(3)) if attempt.any_unit else Unit.of(mesh)
    given = _joined({"mesh": unit.enter(mesh)}, unit.enter_points(arrays))
    reply = run_apart(work, f"{task.name} {attempt.library}", given, limits)
    if reply.ended_by == "time":
        return Attempted(None, f"{reply.why} (--seconds gives more)", "time", reply.seconds)
    known = None if reply.seconds is None else version(attempt.library)
    if reply.why:
        return Attempted(None, reply.why, reply.ended_by, reply.seconds, known)
    try:
        made = Made(reply.data, *_parted(reply.arrays))
    except ValueError as error:
        return Attempted(None, str(error), "crash")
    return Attempted(unit.leave(made, task.powers), seconds=reply.seconds, version=known)


def work(word: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Make the attempt "TASK LIBRARY"; runs in the child process."""
    name, library = word.split()
    task = TASKS[name]
    attempt = next(one for one in (*task.attempts, *task.instead) if one.library == library)
    meshes, further = _parted(arrays)
    made = attempt.work(meshes["mesh"], further)
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


@dataclass(frozen=True, eq=False)
class Unit:
    """A length, and the point (3,) that places are counted from, in the asset's coordinates."""

    length: float
    middle: NDArray[np.float64]

    @classmethod
    def of(cls, mesh: TriedMesh) -> Unit:
        """Return the unit in which libraries are handed `mesh`."""
        sizes = face_areas(mesh.vertices, mesh.faces)[0]
        sizes = sizes[sizes > 0]
        length = float(np.sqrt(np.median(sizes))) if len(sizes) else mesh.diagonal
        is_used = np.zeros(len(mesh.vertices), bool)
        is_used[mesh.faces] = True
        used = mesh.vertices[is_used].astype(np.float64)
        return cls(length or 1.0, np.median(used, axis=0) if len(used) else np.zeros(3))

    def enter(self, mesh: TriedMesh) -> TriedMesh:
        """Return the asset's mesh in this unit, its vertices in float64."""
        return replace(mesh, vertices=self._entered(mesh.vertices))

    def enter_points(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the arrays, those of points in this unit."""
        return {name: self._entered(one) if _are_points(one) else one for name, one in arrays.items()}

    def leave(self, made: Made, powers: Mapping[str, int]) -> Made:
        """Return what was made in this unit in that of the asset.

        `powers` are 1, 2 or 3 for numbers that are lengths, areas or volumes.
        """
        numbers = {
            name: value * self.length ** powers[name] if name in powers and value is not None else value
            for name, value in made.numbers.items()
        }
        meshes = {
            name: replace(one, vertices=self._left(one.vertices).astype(np.float32))
            for name, one in made.meshes.items()
        }
        arrays = {name: self._left(one) if _are_points(one) else one for name, one in made.arrays.items()}
        return Made(numbers, meshes, arrays)

    def _entered(self, points: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray((points.astype(np.float64) - self.middle) / self.length)

    def _left(self, points: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(points.astype(np.float64) * self.length + self.middle)


def _are_points(array: NDArray[Any]) -> bool:
    return array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind == "f"
