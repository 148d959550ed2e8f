"""Decimation to a half, a quarter and a tenth of the faces, by two libraries; the better one counts."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.metrics.likeness import ALIKE, NEARLY, decibels
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh
from msb.trial.task import OUTCOMES, Attempt, Judgement, Made, Numbers, Outcome, Task, file_outcome, worst

SLACK = 1.05  # a target counts as reached with up to this multiple of its faces


def _target(mesh: TriedMesh, percent: int) -> int:
    return max(1, len(mesh.faces) * percent // 100)


def _fast_simplification(mesh: TriedMesh, _: Arrays, *, percent: int) -> Made:
    import fast_simplification

    faces = mesh.faces.astype(np.int32)
    *_mesh, collapses = fast_simplification.simplify(
        mesh.vertices, faces, target_count=_target(mesh, percent), return_collapses=True
    )
    # It knows no colours: a vertex gets the mean of those that were merged into it and that faces used. One
    # whose faces are all gone is merged into none.
    vertices, kept, merged = fast_simplification.replay_simplification(mesh.vertices, faces, collapses)
    used = np.unique(mesh.faces)
    used = used[np.asarray(merged)[used] >= 0]
    into = np.asarray(merged)[used]
    count = np.maximum(np.bincount(into, minlength=len(vertices)), 1)
    sums = [np.bincount(into, mesh.colors[used, k], len(vertices)) for k in range(3)]
    colors = (np.stack(sums, axis=1) / count[:, None]).astype(np.float32)
    return Made({}, {"mesh": TriedMesh(vertices, kept.astype(np.int64), colors)})


def by_pymeshlab(mesh: TriedMesh, _: Arrays, *, percent: int) -> Made:
    """Return the mesh with `percent` of its faces, by quadric edge collapse."""
    import pymeshlab

    opaque = np.ones((len(mesh.colors), 1))
    colors = np.concatenate([mesh.colors.astype(np.float64), opaque], axis=1)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices.astype(np.float64), mesh.faces, v_color_matrix=colors))
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=_target(mesh, percent))
    simplified = meshes.current_mesh()
    made = TriedMesh(
        simplified.vertex_matrix(),
        simplified.face_matrix().astype(np.int64),
        simplified.vertex_color_matrix()[:, :3].astype(np.float32),
    )
    return Made({}, {"mesh": made})


def _judge(mesh: TriedMesh, made: Mapping[str, Made], look: Look, *, percent: int) -> Judgement:
    target = _target(mesh, percent)
    numbers: Numbers = {"target_faces": target}
    best: tuple[int, bool, float] | None = None
    outcome: Outcome = "fails"
    why: str | None = None
    for library, one in made.items():
        simplified = one.meshes["mesh"]
        reached = 0 < len(simplified.faces) <= SLACK * target
        likeness = look.psnr(simplified)
        numbers[_key(library)] = own = {
            "faces": len(simplified.faces),
            "reached": reached,
            **likeness,
            **one.numbers,
        }
        grade, reason = _grade(own, target)
        of_file = worst((grade, file_outcome(mesh, simplified)))
        rank = (OUTCOMES.index(of_file), not reached, -(likeness["psnr"] or 0.0))
        if best is None or rank < best:
            best, outcome, why = rank, grade, reason
            numbers["best"] = library
    return Judgement(outcome, why, numbers)


def _grade(own: Numbers, target: int) -> tuple[Outcome, str | None]:
    if not own["reached"]:
        return "fails", f"it stops at {own['faces']:,} faces; {target:,} were asked for"
    likeness = own["psnr"]
    if likeness is None or likeness >= ALIKE:
        return "works", None
    if likeness >= NEARLY:
        return "care", f"the difference can be seen ({decibels(likeness)})"
    return "fails", f"it looks different ({decibels(likeness)})"


def _key(library: str) -> str:
    return library.replace("-", "_")


def _says(numbers: Numbers) -> str:
    libraries = [library for library, _, _ in _LIBRARIES if _key(library) in numbers]
    libraries.sort(key=lambda library: library != numbers["best"])
    parts = []
    for library in libraries:
        own = numbers[_key(library)]
        likeness = "" if own["psnr"] is None else f"{decibels(own['psnr'])} with "
        parts.append(f"{likeness}{own['faces']:,} faces by {library}")
    return ", ".join(parts)


def beside(_: TriedMesh, made: Mapping[str, Made], look: Look) -> NDArray[Any] | None:
    """Draw what each library made, side by side."""
    drawn = [look.picture(mesh) for one in made.values() for mesh in one.meshes.values()]
    pictures = [one for one in drawn if one is not None]
    return np.concatenate(pictures, axis=1) if pictures else None


_LIBRARIES = (
    ("fast-simplification", "fast_simplification", _fast_simplification),
    ("pymeshlab", "pymeshlab", by_pymeshlab),
)
TASKS = tuple(
    Task(
        f"decimate_{percent}",
        f"Decimation to {percent} %",
        tuple(
            Attempt(library, (module,), partial(work, percent=percent))
            for library, module, work in _LIBRARIES
        ),
        partial(_judge, percent=percent),
        _says,
        picture=beside,
        by_look=True,
    )
    for percent in (50, 25, 10)
)
