"""Small meshes with known results, and tasks without renderings."""

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
    """A stand-in for `Renderings` on a system without a device. Judgements then depend on numbers only."""

    why_not = "no OpenCL device was found"

    def psnr(self, _: TrialMesh) -> dict[str, Any]:
        return {"psnr": None, "same_pictures": None}

    def empty_share(self, _points: Any, _tolerance: float) -> None:
        return None

    def picture(self, *_: Any) -> None:
        return None


def white_mesh(vertices: ArrayLike, faces: ArrayLike) -> TrialMesh:
    """Return a white mesh."""
    points = np.asarray(vertices, np.float32).reshape(-1, 3)
    return TrialMesh(points, np.asarray(faces, np.int64).reshape(-1, 3), np.ones_like(points))


def box(low: float = 0.0, side: float = 1.0) -> TrialMesh:
    """Return a closed box with outward winding."""
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = [(quad[0], *quad[k : k + 2]) for quad in QUADS for k in (1, 2)]
    return white_mesh(low + side * np.array(corners), faces)


def concatenate(*meshes: TrialMesh) -> TrialMesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return white_mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def grid(side: int = 6) -> TrialMesh:
    """Return a flat, open grid of 2 side^2 faces over the unit square."""
    points = [[x / side, y / side, 0] for x in range(side + 1) for y in range(side + 1)]
    first = [x * (side + 1) + y for x in range(side) for y in range(side)]
    step = side + 1
    faces = [row for v in first for row in ((v, v + step, v + 1), (v + 1, v + step, v + step + 1))]
    return white_mesh(points, faces)


def soup(mesh: TrialMesh) -> TrialMesh:
    """Return the triangle soup of the mesh, with three vertices per face."""
    return white_mesh(mesh.vertices[mesh.faces.reshape(-1)], np.arange(mesh.faces.size).reshape(-1, 3))


def pages(count: int = 3) -> TrialMesh:
    """Return `count` faces at one edge, like the pages of a book."""
    outer = [[np.cos(k), np.sin(k), 0.5] for k in range(count)]
    return white_mesh([[0, 0, 0], [0, 0, 1], *outer], [[0, 1, 2 + k] for k in range(count)])


def bow_tie() -> TrialMesh:
    """Return two triangles that share a vertex but no edge."""
    return white_mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], [[0, 1, 2], [0, 3, 4]])


MESHES = {
    "box": box(),
    "two boxes": concatenate(box(), box(3.0)),
    "boxes that cross": concatenate(box(), box(0.5)),
    "open grid": grid(),
    "bow-tie": bow_tie(),
    "soup": soup(box()),
    "pages": pages(),
}


def attempt(task: str, mesh: TrialMesh) -> tuple[dict[str, Output], Judgement]:
    """Run all attempts at a task in this process, and judge them without renderings."""
    selected = TASKS[task]
    for entry in selected.attempts:
        for module in entry.modules:
            pytest.importorskip(module)
    outputs = {entry.library: entry.work(mesh, {}) for entry in selected.attempts}
    renderings: Any = NoRenderings()
    return outputs, selected.judge(mesh, outputs, renderings)
