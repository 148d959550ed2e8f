"""Run the attempts at a task in child processes, so that a hang or a crash affects only one attempt.

Libraries have absolute limits in the unit of the coordinates. For example, xatlas drops faces smaller than
1e-7, and fast-simplification cannot resolve errors below 1e-6. Therefore a mesh is moved to its centre, and
scaled to a median face area of 1. If a single face is far away, scaling the bounding box to size 1 would make
most faces too small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import run_in_child
from msb.base.limits import Limits
from msb.topology.faces import face_areas
from msb.trial.mesh import TrialMesh
from msb.trial.registry import TASKS
from msb.trial.task import Attempt, AttemptResult, Output, Task


def run_attempt(
    task: Task, attempt: Attempt, mesh: TrialMesh, arrays: Mapping[str, NDArray[Any]], limits: Limits
) -> AttemptResult:
    """Run an attempt at a task and return its result.

    The argument `arrays` contains the result of `Task.prepare`.
    """
    unit = Unit(1.0, np.zeros(3)) if attempt.any_unit else Unit.of(mesh)
    inputs = _pack({"mesh": unit.to_unit(mesh)}, unit.arrays_to_unit(arrays))
    reply = run_in_child(work, f"{task.name} {attempt.library}", inputs, limits)
    if reply.ended_by == "time":
        return AttemptResult(None, f"{reply.why} (use a larger --seconds)", "time", reply.seconds)
    known_version = None if reply.seconds is None else version(attempt.library)
    if reply.why:
        return AttemptResult(None, reply.why, reply.ended_by, reply.seconds, known_version)
    try:
        output = Output(reply.data, *_unpack(reply.arrays))
    except ValueError as error:
        return AttemptResult(None, str(error), "crash")
    output = unit.from_unit(output, task.powers)
    return AttemptResult(output, seconds=reply.seconds, version=known_version)


def work(word: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Run the attempt "TASK LIBRARY". The attempt runs in the child process."""
    name, library = word.split()
    task = TASKS[name]
    attempt = next(entry for entry in (*task.attempts, *task.fallbacks) if entry.library == library)
    meshes, further = _unpack(arrays)
    output = attempt.work(meshes["mesh"], further)
    return output.numbers, _pack(output.meshes, output.arrays)


def _pack(meshes: Mapping[str, TrialMesh], arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of all meshes with keys "MESH.ARRAY". Also add `arrays`."""
    parts = {f"{name}.{key}": array for name, mesh in meshes.items() for key, array in mesh.arrays().items()}
    return {**parts, **arrays}


def _unpack(
    arrays: Mapping[str, NDArray[Any]],
) -> tuple[dict[str, TrialMesh], dict[str, NDArray[Any]]]:
    """Return the meshes and the other arrays that `_pack` stored."""
    parts: dict[str, dict[str, NDArray[Any]]] = {}
    further: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        mesh, dot, key = name.partition(".")
        if dot:
            parts.setdefault(mesh, {})[key] = array
        else:
            further[name] = array
    return {mesh: TrialMesh.of(mesh, rows) for mesh, rows in parts.items()}, further


@dataclass(frozen=True, eq=False)
class Unit:
    """A coordinate system for libraries. The coordinate system has a unit of length and an origin (3,) in the
    asset's coordinates."""

    length: float
    origin: NDArray[np.float64]

    @classmethod
    def of(cls, mesh: TrialMesh) -> Unit:
        """Return the unit for `mesh`. The unit is the side length of a square with the median face area."""
        areas = face_areas(mesh.vertices, mesh.faces)[0]
        areas = areas[areas > 0]
        length = float(np.sqrt(np.median(areas))) if len(areas) else mesh.diagonal
        is_used = np.zeros(len(mesh.vertices), bool)
        is_used[mesh.faces] = True
        used = mesh.vertices[is_used].astype(np.float64)
        return cls(length or 1.0, np.median(used, axis=0) if len(used) else np.zeros(3))

    def to_unit(self, mesh: TrialMesh) -> TrialMesh:
        """Return `mesh` in this coordinate system, with float64 vertices."""
        return replace(mesh, vertices=self._scale(mesh.vertices))

    def arrays_to_unit(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the arrays with all points converted to this coordinate system."""
        return {name: self._scale(rows) if _are_points(rows) else rows for name, rows in arrays.items()}

    def from_unit(self, output: Output, powers: Mapping[str, int]) -> Output:
        """Convert an output from this coordinate system to the asset's coordinates.

        The argument `powers` gives the dimension of each number: 1 for a length, 2 for an area, 3 for a
        volume. Numbers that are not in `powers` stay unchanged.
        """
        numbers = {
            name: value * self.length ** powers[name] if name in powers and value is not None else value
            for name, value in output.numbers.items()
        }
        meshes = {
            name: replace(mesh, vertices=self._unscale(mesh.vertices).astype(np.float32))
            for name, mesh in output.meshes.items()
        }
        arrays = {
            name: self._unscale(rows) if _are_points(rows) else rows for name, rows in output.arrays.items()
        }
        return Output(numbers, meshes, arrays)

    def _scale(self, points: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray((points.astype(np.float64) - self.origin) / self.length)

    def _unscale(self, points: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(points.astype(np.float64) * self.length + self.origin)


def _are_points(array: NDArray[Any]) -> bool:
    return array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind == "f"
