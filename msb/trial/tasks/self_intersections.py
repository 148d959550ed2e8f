"""Faces that cross each other (`msb.topology.crossings`), and slivers, which a structural audit ignores."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.crossings import crossing_pairs
from msb.topology.verdict import percent
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Numbers, Task, counted, graded, judged

FEW = 0.01  # share of crossing faces; one in a hundred is repaired by hand
FEW_SLIVERS, MANY_SLIVERS = 0.01, 0.1
_CROSSING, _SLIVER, _PLAIN = (0.85, 0.1, 0.1), (0.9, 0.7, 0.1), (0.75, 0.75, 0.75)
SLIVER = 0.01  # height over the longest side below which a face is a sliver; its smallest angle is below 1.2°


def _work(mesh: TriedMesh, _: Arrays) -> Made:
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    pairs = crossing_pairs(corners)
    thin = slivers(corners)
    crossing = np.zeros(len(corners), bool)
    crossing[pairs.reshape(-1)] = True
    count = max(1, len(corners))
    numbers = {
        "pairs": len(pairs),
        "faces": int(crossing.sum()),
        "face_share": float(crossing.sum() / count),
        "slivers": int(thin.sum()),
        "sliver_share": float(thin.sum() / count),
    }
    return Made(numbers, {}, {"crossing": crossing, "sliver": thin})


def _judge(mesh: TriedMesh, made: Mapping[str, Made], __: Look) -> Judgement:
    numbers = made["numpy"].numbers
    crossing = graded(numbers["face_share"], 0.0, FEW)
    thin = graded(numbers["sliver_share"], FEW_SLIVERS, MANY_SLIVERS)
    return judged(
        numbers,
        (crossing, f"{percent(numbers['faces'], len(mesh.faces))} of the faces cross another"),
        (thin, f"{percent(numbers['slivers'], len(mesh.faces))} are slivers"),
    )


def _says(numbers: Numbers) -> str:
    crossing = counted(numbers["faces"], "face crosses", "faces cross")
    return f"{crossing}, {counted(numbers['slivers'], 'sliver')}"


def _picture(mesh: TriedMesh, made: Mapping[str, Made], look: Look) -> NDArray[Any] | None:
    """Draw the mesh with the faces that cross in red, slivers in yellow."""
    marks = made["numpy"].arrays
    colors = np.full((len(mesh.faces), 3), _PLAIN, np.float32)
    colors[marks["sliver"]] = _SLIVER
    colors[marks["crossing"]] = _CROSSING
    return look.picture(mesh.unshared(np.repeat(colors, 3, axis=0)))


def slivers(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which faces (F,) of corners (F, 3, 3) are slivers; faces without area are."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.sqrt((sides**2).sum(axis=2).max(axis=1))
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray((twice < SLIVER * longest**2) | (longest == 0))


TASKS = (
    Task(
        "self_intersections",
        "Self-intersections, slivers",
        (Attempt("numpy", ("numpy",), _work, any_unit=True),),
        _judge,
        _says,
        picture=_picture,
    ),
)
