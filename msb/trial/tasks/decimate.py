"""Decimate a mesh to 50, 25 and 10 % of its faces with two libraries.

The better result determines the outcome.
"""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.metrics.likeness import ALIKE, NEARLY, decibels
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings
from msb.trial.task import (
    Attempt,
    Judgement,
    Numbers,
    Outcome,
    Output,
    Outputs,
    Task,
    file_outcome,
    pick_worst,
)

# A result may exceed the requested number of faces by this factor.
SLACK = 1.05


def _count_target_faces(mesh: TrialMesh, percent: int) -> int:
    """Return the requested number of faces."""
    return max(1, len(mesh.faces) * percent // 100)


def _decimate_with_fast_simplification(mesh: TrialMesh, _: Arrays, *, percent: int) -> Output:
    """Decimate the mesh with fast-simplification."""
    import fast_simplification

    faces = mesh.faces.astype(np.int32)
    *_mesh, collapses = fast_simplification.simplify(
        mesh.vertices, faces, target_count=_count_target_faces(mesh, percent), return_collapses=True
    )
    # The library drops vertex colours. Repeat the edge collapses to find the new vertex of each old vertex.
    # The value is -1 if the old vertex was removed. The colour of a new vertex is the average colour of the
    # old vertices that were merged into it.
    vertices, kept, merged = fast_simplification.replay_simplification(mesh.vertices, faces, collapses)
    used = np.unique(mesh.faces)
    used = used[np.asarray(merged)[used] >= 0]
    into = np.asarray(merged)[used]
    count = np.maximum(np.bincount(into, minlength=len(vertices)), 1)
    sums = [np.bincount(into, mesh.colors[used, k], len(vertices)) for k in range(3)]
    colors = (np.stack(sums, axis=1) / count[:, None]).astype(np.float32)
    return Output({}, {"mesh": TrialMesh(vertices, kept.astype(np.int64), colors)})


def decimate_with_pymeshlab(mesh: TrialMesh, _: Arrays, *, percent: int) -> Output:
    """Decimate the mesh to `percent` of its faces with PyMeshLab's quadric edge collapse."""
    import pymeshlab

    opaque = np.ones((len(mesh.colors), 1))
    colors = np.concatenate([mesh.colors.astype(np.float64), opaque], axis=1)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices.astype(np.float64), mesh.faces, v_color_matrix=colors))
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=_count_target_faces(mesh, percent))
    simplified = meshes.current_mesh()
    result = TrialMesh(
        simplified.vertex_matrix(),
        simplified.face_matrix().astype(np.int64),
        simplified.vertex_color_matrix()[:, :3].astype(np.float32),
    )
    return Output({}, {"mesh": result})


def _judge(mesh: TrialMesh, outputs: Outputs, renderings: Renderings, *, percent: int) -> Judgement:
    target = _count_target_faces(mesh, percent)
    numbers: Numbers = {"target_faces": target}
    best: tuple[int, bool, float] | None = None
    outcome: Outcome = "fails"
    why: str | None = None
    # Grade each library. Rank the libraries by outcome. Equal outcomes are ranked by reaching the target,
    # then by PSNR.
    for library, output in outputs.items():
        simplified = output.meshes["mesh"]
        reached = 0 < len(simplified.faces) <= SLACK * target
        likeness = renderings.psnr(simplified)
        numbers[_make_key(library)] = entry = {
            "faces": len(simplified.faces),
            "reached": reached,
            **likeness,
            **output.numbers,
        }
        library_outcome, reason = _grade(entry, target)
        with_file = Judgement(pick_worst((library_outcome, file_outcome(mesh, simplified))))
        rank = (with_file.rank, not reached, -(likeness["psnr"] or 0.0))
        if best is None or rank < best:
            best, outcome, why = rank, library_outcome, reason
            numbers["best"] = library
    return Judgement(outcome, why, numbers)


def _grade(entry: Numbers, target: int) -> tuple[Outcome, str | None]:
    """Return the outcome of a library, and the reason for a limitation or failure."""
    if not entry["reached"]:
        return "fails", f"the library stops at {entry['faces']:,} of {target:,} requested faces"
    likeness = entry["psnr"]
    if likeness is None or likeness >= ALIKE:
        return "works", None
    if likeness >= NEARLY:
        return "care", f"the difference is visible ({decibels(likeness)})"
    return "fails", f"it looks different ({decibels(likeness)})"


def _make_key(library: str) -> str:
    """Return the key for storing the numbers of a library."""
    return library.replace("-", "_")


def _summarize(numbers: Numbers) -> str:
    """Return the results of the libraries, best first."""
    libraries = [library for library, _, _ in _LIBRARIES if _make_key(library) in numbers]
    libraries.sort(key=lambda library: library != numbers["best"])
    parts = []
    for library in libraries:
        entry = numbers[_make_key(library)]
        likeness = "" if entry["psnr"] is None else f"{decibels(entry['psnr'])} with "
        parts.append(f"{likeness}{entry['faces']:,} faces by {library}")
    return ", ".join(parts)


def draw_side_by_side(_: TrialMesh, outputs: Outputs, renderings: Renderings) -> NDArray[Any] | None:
    """Draw the results of all libraries side by side."""
    drawn = [renderings.picture(mesh) for output in outputs.values() for mesh in output.meshes.values()]
    pictures = [image for image in drawn if image is not None]
    return np.concatenate(pictures, axis=1) if pictures else None


_LIBRARIES = (
    ("fast-simplification", "fast_simplification", _decimate_with_fast_simplification),
    ("pymeshlab", "pymeshlab", decimate_with_pymeshlab),
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
        _summarize,
        picture=draw_side_by_side,
        needs_images=True,
    )
    for percent in (50, 25, 10)
)
