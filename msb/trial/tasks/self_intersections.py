"""Count crossing faces (`msb.topology.crossings`) and slivers, which the structural audit does not count."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.crossings import find_crossing_pairs
from msb.topology.verdict import percent
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings
from msb.trial.task import Attempt, Judgement, Numbers, Output, Outputs, Task, combine, format_count, grade

# Largest fraction of crossing faces for "works with limitations". This fraction, 1 %, can be repaired by
# hand.
FEW = 0.01
# Largest fraction of slivers for "works". With more slivers, the outcome is "works with limitations".
# Slivers shade badly, but the audit still calls the mesh OK.
FEW_SLIVERS = 0.01
# Colours of crossing faces, slivers and other faces in the image: red, yellow and grey.
_CROSSING, _SLIVER, _PLAIN = (0.85, 0.1, 0.1), (0.9, 0.7, 0.1), (0.75, 0.75, 0.75)
# A face is a sliver if its height is below this fraction of its longest side. The smallest angle of a sliver
# is below 1.2 degrees.
SLIVER = 0.01


def _work(mesh: TrialMesh, _: Arrays) -> Output:
    """Count crossing faces and slivers, and mark both in arrays (F,)."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    pairs = find_crossing_pairs(corners)
    thin = find_slivers(corners)
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
    return Output(numbers, {}, {"crossing": crossing, "sliver": thin})


def _judge(mesh: TrialMesh, outputs: Outputs, __: Renderings) -> Judgement:
    numbers = outputs["numpy"].numbers
    crossing = grade(numbers["face_share"], 0.0, FEW)
    thin = grade(numbers["sliver_share"], FEW_SLIVERS, 1.0)
    return combine(
        numbers,
        (crossing, f"{percent(numbers['faces'], len(mesh.faces))} of the faces cross other faces"),
        (thin, f"{percent(numbers['slivers'], len(mesh.faces))} are slivers"),
    )


def _summarize(numbers: Numbers) -> str:
    crossing = format_count(numbers["faces"], "face crosses", "faces cross")
    return f"{crossing}, {format_count(numbers['slivers'], 'sliver')}"


def _draw_picture(mesh: TrialMesh, outputs: Outputs, renderings: Renderings) -> NDArray[Any] | None:
    """Draw the mesh with crossing faces in red and slivers in yellow."""
    marks = outputs["numpy"].arrays
    colors = np.full((len(mesh.faces), 3), _PLAIN, np.float32)
    colors[marks["sliver"]] = _SLIVER
    colors[marks["crossing"]] = _CROSSING
    return renderings.picture(mesh.unshared(np.repeat(colors, 3, axis=0)))


def find_slivers(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask (F,) of the slivers. A sliver may also be a face without area. The corners of the faces
    are (F, 3, 3)."""
    # The height of a face is twice the area divided by the longest side. Compare the height of a face with
    # its longest side.
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
        _summarize,
        picture=_draw_picture,
    ),
)
