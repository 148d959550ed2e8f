"""Loop subdivision by libigl: whether it is defined, and the gaps that open where faces were merely beside.

Loop's rule knows edges of one and of two faces. Modelling programs turn faces to one winding, cut the mesh at
all other edges and go on; so is done here. The copies of an edge are then smoothed apart, and the area
between them is a crack.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msb.topology.components import label_components
from msb.trial.geometry import areas
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Task, graded, worst

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.trial.look import Look
    from msb.trial.task import Numbers

FEW_LONE, MANY_LONE = 0.01, 0.1
"""Share of the faces that have no neighbour: there is no surface to make smooth."""
SMALL_GAPS = 0.001
"""Area of the cracks, of the surface's: the most that a picture mostly hides."""


def _work(mesh: TriedMesh, _: Mapping[str, Any], __: Mapping[str, NDArray[Any]]) -> Made:
    import igl

    stored = _proper(mesh.faces)
    if not len(stored):
        raise ValueError("it has no proper face")
    crowded, clashes = _undefined(stored)
    proper = turned_alike(stored)
    cut, origin = cut_apart(proper)
    matrix, faces = igl.loop_matrix(cut, len(origin))
    points = matrix @ mesh.vertices[origin].astype(np.float64)
    colors = np.clip(matrix @ mesh.colors[origin].astype(np.float64), 0, 1)
    made = TriedMesh(points.astype(np.float32), faces.astype(np.int64), colors.astype(np.float32))
    gaps = gap_area(mesh.vertices.astype(np.float64), proper, cut, points, faces)
    surface = float(areas(mesh.vertices, proper).sum())
    numbers = {
        "defined": not (crowded or clashes or len(origin) > len(np.unique(proper))),
        "edges_of_three_faces": crowded,
        "edges_of_clashing_winding": clashes,
        "vertices_cut": len(origin) - len(np.unique(proper)),
        "lone_share": _lone_share(proper),
        "faces": len(faces),
        "gap_area": gaps,
        "gap_share": gaps / surface if surface else None,
    }
    return Made(numbers, {"mesh": made})


def _proper(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the faces of three different vertices."""
    a, b, c = faces.T
    return np.asarray(faces[(a != b) & (b != c) & (c != a)])


def _half_edges(faces: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[np.int64], NDArray[np.int64]]:
    """Return each half-edge's direction and edge (3f + k is a face's k-th), and each edge's faces."""
    start, stop = faces.reshape(-1), faces[:, (1, 2, 0)].reshape(-1)
    ends = np.stack([np.minimum(start, stop), np.maximum(start, stop)], axis=1)
    _, edge, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    return start < stop, edge.reshape(-1), count


def _undefined(faces: NDArray[np.int64]) -> tuple[int, int]:
    """Return the number of edges of more than two faces, and of two that both run along it alike."""
    _, _, count = _half_edges(faces)
    agree = _neighbours(faces)[2]
    return int(np.count_nonzero(count > 2)), int(np.count_nonzero(~agree))


def turned_alike(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the faces (F, 3), turned so that two that alone share an edge run along it in both directions.

    In a graph with two nodes for each face, one for each winding, an edge joins the windings that agree. A
    piece that can be turned is there twice; one that cannot, such as a Möbius strip, once, and stays.
    """
    one, other, agree = _neighbours(faces)
    count = len(faces)
    first = np.concatenate([one, one + count])
    second = np.where(np.concatenate([agree, ~agree]), np.tile(other, 2), np.tile(other, 2) + count)
    _, label = label_components(2 * count, first, second)
    turn = label[:count] > label[count:]
    return np.where(turn[:, None], faces[:, ::-1], faces)


def _lone_share(faces: NDArray[np.int64]) -> float:
    """Return the share of faces that are joined to no other, which the rule shrinks each by itself."""
    one, other, agree = _neighbours(faces)
    joined = np.zeros(len(faces), bool)
    joined[np.concatenate([one[agree], other[agree]])] = True
    return float(1 - joined.mean())


def _neighbours(faces: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
    """Return the two faces of each edge of two, and whether their windings agree."""
    one, other = _pairs(faces)
    forward, _, _ = _half_edges(faces)
    return one // 3, other // 3, forward[one] != forward[other]


def _pairs(faces: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the two half-edges of each edge of two faces."""
    _, edge, count = _half_edges(faces)
    order = np.argsort(edge, kind="stable")
    place = (np.cumsum(count) - count)[count == 2]
    return order[place], order[place + 1]


def cut_apart(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return faces that stay joined only across edges of two faces with one winding, and vertices' origins.

    Parameters
    ----------
    faces : (F, 3) int64
        Of three different vertices each.

    Returns
    -------
    cut : (F, 3) int64
        Every vertex has one fan of faces.
    origin : (W,) int64
        The vertex that each new one is a copy of.
    """
    forward, _, _ = _half_edges(faces)
    one, other = _pairs(faces)
    agree = forward[one] != forward[other]
    one, other = one[agree], other[agree]

    def after(half: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.where(half % 3 == 2, half - 2, half + 1))

    # Corner 3f + k is where half-edge 3f + k starts; the other half-edge starts where this one ends.
    first = np.concatenate([one, after(one)])
    second = np.concatenate([after(other), other])
    groups, label = label_components(faces.size, first, second)
    origin = np.zeros(groups, np.int64)
    origin[label] = faces.reshape(-1)
    return label.astype(np.int64).reshape(-1, 3), origin


def gap_area(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    cut: NDArray[np.int64],
    points: NDArray[np.float64],
    fine: NDArray[np.int64],
) -> float:
    """Return the area between edges that lay on each other before one subdivision and do not after it.

    Edges lie on each other if their ends have the same coordinates, whether faces share them or not. Of
    several, each is held against the first: four triangles between the halves of both.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces, cut : (F, 3) int64
        As they were, and cut apart.
    points : (W, 3) float64
        The vertices after; the first ones are those of `cut`.
    fine : (4F, 3) int64
        The faces after.
    """
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    _, cut_edge, _ = _half_edges(cut)
    start, stop = cut.reshape(-1), cut[:, (1, 2, 0)].reshape(-1)
    # Each edge of the cut mesh once, from the end with the lower place to the other.
    _, once = np.unique(cut_edge, return_index=True)
    start, stop = start[once], stop[once]
    here, there = (
        place.reshape(-1)[faces.reshape(-1)][once],
        place.reshape(-1)[faces[:, (1, 2, 0)].reshape(-1)][once],
    )
    turned = here > there
    start, stop = np.where(turned, stop, start), np.where(turned, start, stop)
    here, there = np.where(turned, there, here), np.where(turned, here, there)
    middle = _middles(start, stop, fine)
    _, group, count = np.unique(
        np.stack([here, there], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    order = np.argsort(group.reshape(-1), kind="stable")
    lead = order[np.concatenate([[0], np.cumsum(count)[:-1]])][group.reshape(-1)]
    other = np.flatnonzero(lead != np.arange(len(start)))
    curves = points[np.stack([start, middle, stop], axis=1)]
    one, two = curves[lead[other]], curves[other]
    total = 0.0
    for k in (0, 1):
        for corner, left, right in (
            (one[:, k], one[:, k + 1], two[:, k]),
            (two[:, k + 1], one[:, k + 1], two[:, k]),
        ):
            total += float(np.linalg.norm(np.cross(left - corner, right - corner), axis=1).sum() / 2)
    return total


def _middles(start: NDArray[np.int64], stop: NDArray[np.int64], fine: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the new vertex between the ends of each edge: the one that is a neighbour of both afterwards.

    A face abc becomes four, of which three have a corner of it and the middles of the two edges there.
    """
    old = int(max(start.max(), stop.max())) + 1
    corners = fine[(fine < old).sum(axis=1) == 1]
    turn = np.argmax(corners < old, axis=1)
    rows = np.arange(len(corners))
    corner = corners[rows, turn]
    pairs = [(corner, corners[rows, (turn + k) % 3]) for k in (1, 2)]
    vertex, middle = (np.concatenate(each) for each in zip(*pairs, strict=True))
    # Each middle has the two ends of its edge, once or twice each.
    ends = np.unique(np.stack([middle, vertex], axis=1), axis=0)
    low, high = ends[0::2, 1], ends[1::2, 1]
    key = low * np.int64(old) + high
    order = np.argsort(key)
    wanted = np.minimum(start, stop) * np.int64(old) + np.maximum(start, stop)
    return np.asarray(ends[0::2, 0][order][np.searchsorted(key[order], wanted)])


def _judge(_: TriedMesh, made: Mapping[str, Made], look: Look) -> Judgement:
    one = made["libigl"]
    numbers = {**one.numbers, **look.psnr(one.meshes["mesh"])}
    cracks = graded(numbers["gap_share"], 0.0, SMALL_GAPS)
    lone = graded(numbers["lone_share"], FEW_LONE, MANY_LONE)
    reasons = []
    if cracks != "works":
        reasons.append(f"cracks open over {100 * numbers['gap_share']:.2g} % of the surface")
    if lone != "works":
        reasons.append(f"{100 * numbers['lone_share']:.0f} % of the faces have no neighbour and shrink alone")
    if not (reasons or numbers["defined"]):
        first = "is cut" if numbers["vertices_cut"] else "is turned to one winding"
        return Judgement("care", f"the mesh {first} first, which opens nothing", numbers)
    return Judgement(worst((cracks, lone)), "; ".join(reasons) or None, numbers)


def _says(numbers: Numbers) -> str:
    decibels = "" if numbers["psnr"] is None else f", {numbers['psnr']:.1f} dB"
    return f"{numbers['faces']:,} faces{decibels}"


def _picture(_: TriedMesh, made: Mapping[str, Made], look: Look) -> NDArray[Any] | None:
    return look.picture(made["libigl"].meshes["mesh"])


TASKS = (
    Task(
        "subdivide",
        "Loop subdivision",
        (Attempt("libigl", ("igl",), _work),),
        _judge,
        _says,
        picture=_picture,
    ),
)
