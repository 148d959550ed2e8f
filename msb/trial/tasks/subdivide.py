"""Loop subdivision by libigl: check whether Loop's rule is defined, and measure opening cracks.

Loop's rule is defined for edges with one face and with two faces. Modelling programs make the winding
consistent, cut all edges with more than two faces, and subdivide the result. The subdivision in this module
follows the steps of modelling programs. The copies of a cut edge are smoothed independently, which opens a
crack between them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.metrics.likeness import decibels
from msb.topology.faces import face_areas, names_vertex_twice
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of
from msb.topology.steps import turn_faces
from msb.topology.steps.cut import split_vertices
from msb.topology.weld import merge_coincident
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings
from msb.trial.task import Attempt, Judgement, Numbers, Output, Outputs, Task, combine, grade
from msb.trial.tasks.decimate import draw_side_by_side

# Largest fractions of faces without a neighbour, for "works" and for "works with limitations". If a face has
# no neighbour, subdivision only shrinks the face.
FEW_LONE, MANY_LONE = 0.01, 0.1
# Largest area of cracks for "works with limitations", as a fraction of the surface area. Cracks below this
# area are mostly invisible in images.
SMALL_GAPS = 0.001


def _work(mesh: TrialMesh, _: Arrays) -> Output:
    """Subdivide the mesh once, and measure the cracks and the faces without a neighbour."""
    import igl

    proper = mesh.faces[~names_vertex_twice(mesh.faces)]
    if not len(proper):
        raise ValueError("the mesh has no valid face")
    # Remove unused vertices, and count the edges at which Loop's rule is not defined.
    used, stored = np.unique(proper, return_inverse=True)
    stored = stored.reshape(-1, 3)
    vertices = mesh.vertices[used].astype(np.float64)
    given = build_half_edges(stored, len(used))
    crowded = int(np.count_nonzero(given.multiplicity > 2))
    clashes = len(given.two_face_halfedges[0]) - len(find_agreeing_halfedges(given)[0])
    # Make the winding consistent, cut the mesh, and subdivide it. `origin` (W,) contains the old vertex of
    # each new vertex.
    turned = turn_faces(stored, len(used)).faces
    cut, origin = cut_apart(turned, len(used))
    matrix, faces = igl.loop_matrix(cut, len(origin))
    points = matrix @ vertices[origin]
    colors = np.clip(matrix @ mesh.colors[used][origin].astype(np.float64), 0, 1)
    result = TrialMesh(points.astype(np.float32), faces.astype(np.int64), colors.astype(np.float32))
    gaps = measure_gap_area(vertices[origin], cut, points, faces)
    surface = float(face_areas(vertices, stored)[0].sum())
    numbers = {
        "defined": not (crowded or clashes or len(origin) > len(used)),
        "edges_of_three_faces": crowded,
        "edges_of_clashing_winding": clashes,
        "vertices_cut": len(origin) - len(used),
        "lone_share": _measure_lone_share(build_half_edges(turned, len(used))),
        "faces": len(faces),
        "gap_area": gaps,
        "gap_share": gaps / surface if surface else None,
    }
    return Output(numbers, {"mesh": result})


def find_agreeing_halfedges(mesh: HalfEdgeMesh) -> tuple[NDArray[Any], NDArray[Any]]:
    """For each consistently wound edge of two faces, return the first half-edge (n,) and the second half-edge
    (n,).
    """
    first, second = mesh.two_face_halfedges
    agree = mesh.origin[first] != mesh.origin[second]
    return first[agree], second[agree]


def _measure_lone_share(mesh: HalfEdgeMesh) -> float:
    """Return the fraction of faces that are not connected to any other face."""
    joined = np.zeros(mesh.face_count, bool)
    joined[face_of(np.concatenate(find_agreeing_halfedges(mesh)))] = True
    return float(1 - joined.mean())


def cut_apart(faces: NDArray[Any], vertex_count: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return the faces (F, 3) after cutting edges. Consistently wound edges of two faces are not cut.

    In the result, each vertex has a single fan of faces. The second result (W,) contains the old vertex of
    each new vertex.
    """
    mesh = build_half_edges(faces, vertex_count)
    change = split_vertices(mesh, *find_agreeing_halfedges(mesh))
    return change.faces.astype(np.int64), change.vertex_map


def measure_gap_area(
    vertices: NDArray[np.float64],
    cut: NDArray[np.int64],
    points: NDArray[np.float64],
    fine: NDArray[np.int64],
) -> float:
    """Return the area of the cracks that subdivision opens between coinciding edges.

    Two edges coincide if their ends have equal coordinates, even if they share no vertices. If more than two
    edges coincide, all other edges are compared with the first edge. The crack between two edges consists of
    four triangles between the halves of the edges.

    The arguments `vertices` (V, 3) and `cut` (F, 3) are the vertices and faces of the cut mesh before the
    subdivision. The arguments `points` (W, 3) and `fine` (4F, 3) are the vertices and faces of the subdivided
    mesh. The array `points` begins with the smoothed vertices of the cut mesh.
    """
    _, place = merge_coincident(vertices, "exact")
    # The edges (E,) of the cut mesh. `place` (V,) contains the index of each vertex's location. Each edge
    # starts at the end with the lower location index.
    start, stop = build_half_edges(cut, len(vertices)).edge_vertices.astype(np.int64).T
    turned = place[start] > place[stop]
    start, stop = np.where(turned, stop, start), np.where(turned, start, stop)
    here, there = place[start], place[stop]
    middle = _find_middles(start, stop, fine)
    # Group coinciding edges. `lead` (E,) contains the first edge in the group of each edge.
    _, group, count = np.unique(
        np.stack([here, there], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    order = np.argsort(group.reshape(-1), kind="stable")
    lead = order[np.concatenate([[0], np.cumsum(count)[:-1]])][group.reshape(-1)]
    other = np.flatnonzero(lead != np.arange(len(start)))
    # After the subdivision, each edge is a curve of three points (n, 3, 3). Add up the triangles between two
    # coinciding curves.
    curves = points[np.stack([start, middle, stop], axis=1)]
    first, second = curves[lead[other]], curves[other]
    total = 0.0
    for k in (0, 1):
        for corner, left, right in (
            (first[:, k], first[:, k + 1], second[:, k]),
            (second[:, k + 1], first[:, k + 1], second[:, k]),
        ):
            total += float(np.linalg.norm(np.cross(left - corner, right - corner), axis=1).sum() / 2)
    return total


def _find_middles(
    start: NDArray[np.int64], stop: NDArray[np.int64], fine: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the new vertex (E,) at the middle of each edge from `start` (E,) to `stop` (E,).

    A subdivided face abc becomes four faces. Three of the new faces consist of an old corner and the middles
    of two edges.
    """
    old = int(max(start.max(), stop.max())) + 1
    # `corner` (n,) contains the old corners. The central new face has no old corner.
    corners = fine[(fine < old).sum(axis=1) == 1]
    turn = np.argmax(corners < old, axis=1)
    rows = np.arange(len(corners))
    corner = corners[rows, turn]
    pairs = [(corner, corners[rows, (turn + k) % 3]) for k in (1, 2)]
    vertex, middle = (np.concatenate(column) for column in zip(*pairs, strict=True))
    # Each middle is paired with both ends of its edge. A pair is repeated for each face at the edge.
    ends = np.unique(np.stack([middle, vertex], axis=1), axis=0)
    low, high = ends[0::2, 1], ends[1::2, 1]
    # Find the edges by a key made of their two ends.
    key = low * np.int64(old) + high
    order = np.argsort(key)
    wanted = np.minimum(start, stop) * np.int64(old) + np.maximum(start, stop)
    return np.asarray(ends[0::2, 0][order][np.searchsorted(key[order], wanted)])


def _judge(_: TrialMesh, outputs: Outputs, renderings: Renderings) -> Judgement:
    output = outputs["libigl"]
    numbers = {**output.numbers, **renderings.psnr(output.meshes["mesh"])}
    cracks = grade(numbers["gap_share"], 0.0, SMALL_GAPS)
    lone = grade(numbers["lone_share"], FEW_LONE, MANY_LONE)
    if cracks == lone == "works" and not numbers["defined"]:
        change = "cut" if numbers["vertices_cut"] else "turned to a consistent winding"
        return Judgement("care", f"the mesh must be {change} before subdivision, but no cracks open", numbers)
    return combine(
        numbers,
        (cracks, f"cracks cover {100 * (numbers['gap_share'] or 0):.2g} % of the surface"),
        (lone, f"{100 * numbers['lone_share']:.0f} % of the faces have no neighbour and only shrink"),
    )


def _summarize(numbers: Numbers) -> str:
    likeness = "" if numbers["psnr"] is None else f", {decibels(numbers['psnr'])}"
    return f"{numbers['faces']:,} faces{likeness}"


TASKS = (
    Task(
        "subdivide",
        "Loop subdivision",
        (Attempt("libigl", ("igl",), _work, any_unit=True),),
        _judge,
        _summarize,
        picture=draw_side_by_side,
    ),
)
