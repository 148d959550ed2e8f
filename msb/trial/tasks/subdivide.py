"""Loop subdivision by libigl: whether it is defined, and the gaps that open where faces were merely beside.

Loop's rule knows edges of one and of two faces. Modelling programs turn faces to one winding, cut the mesh at
all other edges and go on; so is done here. The copies of an edge are then smoothed apart, and the area
between them is a crack.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.metrics.likeness import decibels
from msb.topology.faces import face_areas, names_vertex_twice
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of
from msb.topology.steps import turn_faces
from msb.topology.steps.cut import split_vertices
from msb.topology.weld import merged_vertices
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Numbers, Task, graded, judged
from msb.trial.tasks.decimate import beside

# Share of the faces without a neighbour; they are no surface to smooth.
FEW_LONE, MANY_LONE = 0.01, 0.1
SMALL_GAPS = 0.001  # area of the cracks, relative to the surface, that an image mostly hides


def _work(mesh: TriedMesh, _: Arrays) -> Made:
    import igl

    proper = mesh.faces[~names_vertex_twice(mesh.faces)]
    if not len(proper):
        raise ValueError("it has no proper face")
    used, stored = np.unique(proper, return_inverse=True)
    stored = stored.reshape(-1, 3)
    vertices = mesh.vertices[used].astype(np.float64)
    given = build_half_edges(stored, len(used))
    crowded = int(np.count_nonzero(given.multiplicity > 2))
    clashes = len(given.two_face_halfedges[0]) - len(agreeing(given)[0])
    turned = turn_faces(stored, len(used)).faces
    cut, origin = cut_apart(turned, len(used))
    matrix, faces = igl.loop_matrix(cut, len(origin))
    points = matrix @ vertices[origin]
    colors = np.clip(matrix @ mesh.colors[used][origin].astype(np.float64), 0, 1)
    made = TriedMesh(points.astype(np.float32), faces.astype(np.int64), colors.astype(np.float32))
    gaps = gap_area(vertices[origin], cut, points, faces)
    surface = float(face_areas(vertices, stored)[0].sum())
    numbers = {
        "defined": not (crowded or clashes or len(origin) > len(used)),
        "edges_of_three_faces": crowded,
        "edges_of_clashing_winding": clashes,
        "vertices_cut": len(origin) - len(used),
        "lone_share": _lone_share(build_half_edges(turned, len(used))),
        "faces": len(faces),
        "gap_area": gaps,
        "gap_share": gaps / surface if surface else None,
    }
    return Made(numbers, {"mesh": made})


def agreeing(mesh: HalfEdgeMesh) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the two half-edges of each edge of two faces that run along it in both directions."""
    one, other = mesh.two_face_halfedges
    agree = mesh.origin[one] != mesh.origin[other]
    return one[agree], other[agree]


def _lone_share(mesh: HalfEdgeMesh) -> float:
    """Return the share of faces that are joined to no other, which the rule shrinks each by itself."""
    joined = np.zeros(mesh.face_count, bool)
    joined[face_of(np.concatenate(agreeing(mesh)))] = True
    return float(1 - joined.mean())


def cut_apart(faces: NDArray[Any], vertex_count: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return faces (F, 3) that stay joined only across edges of two faces with one winding.

    Every vertex has one fan of faces then; the second array (W,) has the vertex that each one is a copy of.
    """
    mesh = build_half_edges(faces, vertex_count)
    change = split_vertices(mesh, *agreeing(mesh))
    return change.faces.astype(np.int64), change.vertex_map


def gap_area(
    vertices: NDArray[np.float64],
    cut: NDArray[np.int64],
    points: NDArray[np.float64],
    fine: NDArray[np.int64],
) -> float:
    """Return the area between edges that lay on each other before one subdivision and do not after it.

    Edges lie on each other if their ends have the same coordinates, whether faces share them or not. Of
    several, each is held against the first: four triangles between the halves of both. `vertices` (V, 3) and
    the faces `cut` (F, 3) are before, cut apart; `points` (W, 3), which begin with the same vertices, and
    `fine` (4F, 3) after.
    """
    _, place = merged_vertices(vertices, "exact")
    # Each edge of the cut mesh once, from the end with the lower place to the other.
    start, stop = build_half_edges(cut, len(vertices)).edge_vertices.astype(np.int64).T
    turned = place[start] > place[stop]
    start, stop = np.where(turned, stop, start), np.where(turned, start, stop)
    here, there = place[start], place[stop]
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
    if cracks == lone == "works" and not numbers["defined"]:
        first = "is cut" if numbers["vertices_cut"] else "is turned to one winding"
        return Judgement("care", f"the mesh {first} first, which opens nothing", numbers)
    return judged(
        numbers,
        (cracks, f"cracks open over {100 * (numbers['gap_share'] or 0):.2g} % of the surface"),
        (lone, f"{100 * numbers['lone_share']:.0f} % of the faces have no neighbour and shrink alone"),
    )


def _says(numbers: Numbers) -> str:
    likeness = "" if numbers["psnr"] is None else f", {decibels(numbers['psnr'])}"
    return f"{numbers['faces']:,} faces{likeness}"


TASKS = (
    Task(
        "subdivide",
        "Loop subdivision",
        (Attempt("libigl", ("igl",), _work, any_unit=True),),
        _judge,
        _says,
        picture=beside,
    ),
)
