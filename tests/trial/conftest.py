"""Small meshes whose answers are known, and tasks without pictures."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from msb.trial.mesh import TrialMesh
from msb.trial.registry import TASKS
from msb.trial.task import Judgement, Output
from tests.cli.conftest import here, msb

__all__ = ["here", "msb"]

QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


class NoRenderings:
    """Pictures that there are not: judgements are then of the numbers alone."""

    why_not = "there is no device"

    def psnr(self, _: TrialMesh) -> dict[str, Any]:
        return {"psnr": None, "same_pictures": None}

    def empty_share(self, _points: Any, _tolerance: float) -> None:
        return None

    def picture(self, *_: Any) -> None:
        return None


def made_of(vertices: ArrayLike, faces: ArrayLike) -> TrialMesh:
    points = np.asarray(vertices, np.float32).reshape(-1, 3)
    return TrialMesh(points, np.asarray(faces, np.int64).reshape(-1, 3), np.ones_like(points))


def box(low: float = 0.0, side: float = 1.0) -> TrialMesh:
    """Return a closed box, wound outwards."""
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = [(quad[0], *quad[k : k + 2]) for quad in QUADS for k in (1, 2)]
    return made_of(low + side * np.array(corners), faces)


def together(*meshes: TrialMesh) -> TrialMesh:
    starts = np.cumsum([0, *(len(one.vertices) for one in meshes)])
    faces = [one.faces + start for one, start in zip(meshes, starts, strict=False)]
    return made_of(np.concatenate([one.vertices for one in meshes]), np.concatenate(faces))


def grid(side: int = 6) -> TrialMesh:
    """Return an open, flat grid of 2 side^2 faces over the unit square."""
    points = [[x / side, y / side, 0] for x in range(side + 1) for y in range(side + 1)]
    first = [x * (side + 1) + y for x in range(side) for y in range(side)]
    step = side + 1
    faces = [row for v in first for row in ((v, v + step, v + 1), (v + 1, v + step, v + step + 1))]
    return made_of(points, faces)


def soup(mesh: TrialMesh) -> TrialMesh:
    """Return the mesh with three vertices of its own for every face."""
    return made_of(mesh.vertices[mesh.faces.reshape(-1)], np.arange(mesh.faces.size).reshape(-1, 3))


def pages(count: int = 3) -> TrialMesh:
    """Return a book of pages: one edge of `count` faces."""
    outer = [[np.cos(k), np.sin(k), 0.5] for k in range(count)]
    return made_of([[0, 0, 0], [0, 0, 1], *outer], [[0, 1, 2 + k] for k in range(count)])


def bow_tie() -> TrialMesh:
    """Return two triangles that share one vertex and no edge."""
    return made_of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], [[0, 1, 2], [0, 3, 4]])


MESHES = {
    "box": box(),
    "two boxes": together(box(), box(3.0)),
    "boxes that cross": together(box(), box(0.5)),
    "open grid": grid(),
    "bow-tie": bow_tie(),
    "soup": soup(box()),
    "pages": pages(),
}


def attempt(task: str, mesh: TrialMesh) -> tuple[dict[str, Output], Judgement]:
    """Make all attempts at a task in this process, and judge them without pictures."""
    chosen = TASKS[task]
    for one in chosen.attempts:
        for module in one.modules:
            pytest.importorskip(module)
    made = {one.library: one.work(mesh, {}) for one in chosen.attempts}
    look: Any = NoRenderings()
    return made, chosen.judge(mesh, made, look)
