"""Make a collision shape with CoACD.

The shape is judged by its convex parts, its distance from the visible surface, and its protrusion. If CoACD
fails, the task tries a convex hull (for moving objects) and a decimated mesh (for static objects).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import face_areas, signed_volume
from msb.topology.hulls import HULL_CORNERS, hull_directions
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings, random_colors
from msb.trial.task import Attempt, Judgement, Numbers, Output, Outputs, Task, combine, format_count, grade
from msb.trial.tasks.decimate import decimate_with_pymeshlab, draw_side_by_side

# Limits for "works" and for "works with limitations": distance from the visible surface to the shape. The
# limit applies to the 95 % quantile of the distances on the surface. The unit of distance is the bounding-box
# diagonal.
NEAR, FAR = 0.02, 0.05
# Limits for "works" and for "works with limitations": fraction of the shape that protrudes. A part of the
# shape protrudes if a camera sees empty space at its place.
LITTLE, MUCH = 0.1, 0.3
# A point protrudes if its distance in front of the surface exceeds this fraction of the diagonal.
TOLERANCE = 0.01
# Number of sample points on the visible surface, and number of sample points in the volume of the shape. With
# 20,000 points, the standard error of fractions is below 0.4 %.
_POINTS = 20_000
# Number of faces of the decimated mesh, in percent of the original number.
_PERCENT = 10


def _prepare(_: TrialMesh, renderings: Renderings) -> dict[str, NDArray[Any]]:
    """Sample the visible surface. The result is the array "visible" (n, 3)."""
    points = renderings.visible_points(_POINTS)
    return {} if points is None else {"visible": points}


def _decompose(mesh: TrialMesh, given: Arrays) -> Output:
    """Decompose the mesh into convex parts with CoACD."""
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices.astype(np.float64), mesh.faces.astype(np.int32)))
    if not parts:
        raise ValueError("it returns no part")
    # Concatenate the parts to points (n, 3) and faces (F, 3). The indices are shifted by the number of
    # earlier points.
    sizes = [len(points) for points, _ in parts]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    points = np.concatenate([np.asarray(vertices, np.float64) for vertices, _ in parts])
    faces = np.concatenate(
        [np.asarray(rows, np.int64) + start for (_, rows), start in zip(parts, starts, strict=True)]
    )
    volumes = [abs(signed_volume(np.asarray(part), np.asarray(rows, np.int64))) for part, rows in parts]
    numbers: Numbers = {"parts": len(parts), "faces": len(faces), "volume": float(sum(volumes))}
    label = np.repeat(np.arange(len(parts)), sizes)
    shape = TrialMesh(points, faces, random_colors(label))
    inside = sample_inside(parts, np.asarray(volumes), _POINTS)
    return Output(numbers | _measure_distances(shape, given), {"shape": shape}, {"inside": inside})


def _make_hull(mesh: TrialMesh, given: Arrays) -> Output:
    """Make the convex hull of the mesh with manifold3d."""
    import manifold3d

    # Limit the number of corners of the convex hull. Use only the farthest vertices in a fixed set of
    # directions.
    used = mesh.vertices[np.unique(mesh.faces)].astype(np.float64)
    farthest = np.unique([int((used @ direction).argmax()) for direction in hull_directions(HULL_CORNERS)])
    solid = manifold3d.Manifold.hull_points(used[farthest]).to_mesh()
    points, faces = (
        np.asarray(solid.vert_properties[:, :3], np.float64),
        np.asarray(solid.tri_verts, np.int64),
    )
    volume = abs(signed_volume(points, faces))
    if volume <= 1e-6 * mesh.diagonal**3:
        raise ValueError("the hull of a flat mesh has no volume")
    numbers: Numbers = {"parts": 1, "faces": len(faces), "volume": volume}
    shape = TrialMesh(points, faces, random_colors(np.zeros(len(points), np.int64)))
    inside = sample_inside([(points, faces)], np.array([volume]), _POINTS)
    return Output(numbers | _measure_distances(shape, given), {"hull": shape}, {"inside": inside})


def _decimate(mesh: TrialMesh, given: Arrays) -> Output:
    """Decimate the mesh with PyMeshLab. Measure the share of the result that is far from the mesh."""
    import igl

    shape = decimate_with_pymeshlab(mesh, {}, percent=_PERCENT).meshes["mesh"]
    if not len(shape.faces):
        raise ValueError("no face is left")
    # Distribute sample points (n, 3) uniformly over the surface. Normalised exponential variables give
    # barycentric coordinates. A sample point that is far from the mesh protrudes.
    rng = np.random.default_rng(0)
    corners = shape.vertices[
        shape.faces[
            rng.choice(len(shape.faces), _POINTS, p=_normalize(face_areas(shape.vertices, shape.faces)[0]))
        ]
    ]
    weights = rng.exponential(size=(_POINTS, 3))
    samples = np.einsum("nk,nki->ni", weights / weights.sum(axis=1, keepdims=True), corners)
    away = np.sqrt(igl.point_mesh_squared_distance(samples, mesh.vertices.astype(np.float64), mesh.faces)[0])
    empty = float(np.count_nonzero(away > TOLERANCE * mesh.diagonal) / _POINTS)
    numbers: Numbers = {"faces": len(shape.faces), "empty_share": empty}
    return Output(numbers | _measure_distances(shape, given), {"mesh": shape})


def _measure_distances(shape: TrialMesh, given: Arrays) -> Numbers:
    """Return two values for the distances from the visible surface to a shape: the average and the 95 %
    quantile.

    Without points of the visible surface, the result is empty.
    """
    import igl

    if not len(given.get("visible", ())):
        return {}
    squares = igl.point_mesh_squared_distance(
        given["visible"].astype(np.float64), shape.vertices, shape.faces
    )[0]
    distances = np.sqrt(squares)
    return {"distance_mean": float(distances.mean()), "distance_95": float(np.quantile(distances, 0.95))}


def sample_inside(
    parts: list[tuple[Any, Any]], volumes: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return `count` reproducible points (count, 3), distributed uniformly over the volume of convex parts.

    Each convex part is split into tetrahedra. Each tetrahedron connects a face with the centre of the part.
    The barycentric coordinates of a point are four exponential variables, divided by their sum.
    """
    rng = np.random.default_rng(0)
    sampled = []
    for number, (points, faces) in zip(rng.multinomial(count, _normalize(volumes)), parts, strict=True):
        if not number:
            continue
        points, faces = np.asarray(points, np.float64), np.asarray(faces, np.int64)
        corners = points[faces]
        # Volumes (F,) of the tetrahedra, up to a constant factor. Choose a tetrahedron for each point, with
        # probability proportional to its volume.
        centre = points.mean(axis=0)
        sizes = np.abs(
            np.einsum("fi,fi->f", corners[:, 0] - centre, np.cross(*(corners[:, k] - centre for k in (1, 2))))
        )
        chosen = corners[rng.choice(len(faces), number, p=_normalize(sizes))]
        weights = rng.exponential(size=(number, 4))
        weights /= weights.sum(axis=1, keepdims=True)
        sampled.append(np.einsum("nk,nki->ni", weights[:, :3], chosen) + weights[:, 3:] * centre)
    return np.concatenate(sampled) if sampled else np.zeros((0, 3))


def _normalize(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sizes (n,) divided by their sum. If all sizes are zero, return equal shares."""
    total = float(sizes.sum())
    return sizes / total if total > 0 else np.full(len(sizes), 1 / len(sizes))


def _judge(mesh: TrialMesh, outputs: Outputs, renderings: Renderings) -> Judgement:
    # Judge all shapes, and use the best shape. Without a shape from CoACD, the best possible outcome is
    # "works with limitations".
    shapes = {library: _judge_shape(mesh, output, renderings) for library, output in outputs.items()}
    best = min(shapes, key=lambda library: shapes[library].rank)
    judgement = shapes[best]
    if best == "coacd":
        return judgement
    kinds = {"manifold3d": "convex hull of {}{}", "pymeshlab": "decimated mesh of {} for static objects{}"}
    parts = [
        "a "
        + kinds[library].format(format_count(shape.numbers["faces"], "face"), _format_brackets(shape.numbers))
        for library, shape in shapes.items()
    ]
    why = f"instead: {' and '.join(parts)}"
    why += f"; {' '.join(kinds[best].split()[:2])}: {judgement.why}" if judgement.why else ""
    instead = {library: shape.numbers for library, shape in shapes.items()}
    numbers = {**judgement.numbers, "best": best, "instead": instead}
    return Judgement("fails" if judgement.outcome == "fails" else "care", why, numbers)


def _judge_shape(mesh: TrialMesh, output: Output, renderings: Renderings) -> Judgement:
    """Return the judgement of a single shape."""
    diagonal = mesh.diagonal
    distance = output.numbers.get("distance_95")
    relative = distance / diagonal if distance is not None and diagonal else None
    if (inside := output.arrays.get("inside")) is None:
        empty = output.numbers["empty_share"]
    else:
        empty = renderings.empty_share(inside, TOLERANCE * diagonal)
    far = f"5 % of the visible surface is farther away than {100 * (relative or 0):.1f} % of the diagonal"
    protrudes = f"{100 * (empty or 0):.0f} % of the shape protrudes into empty space"
    numbers = {**output.numbers, "distance_95_of_diagonal": relative, "empty_share": empty}
    return combine(numbers, (grade(relative, NEAR, FAR), far), (grade(empty, LITTLE, MUCH), protrudes))


def _format_brackets(numbers: Numbers) -> str:
    """Return the distance and the protrusion in brackets, or an empty text."""
    parts = _list_measures(numbers)
    return f" ({', '.join(parts)})" if parts else ""


def _list_measures(numbers: Numbers) -> list[str]:
    """Return the known values of distance and protrusion as a sentence."""
    relative, empty = numbers["distance_95_of_diagonal"], numbers["empty_share"]
    parts = []
    if relative is not None:
        share = "less than 0.01" if relative < 1e-4 else f"{100 * relative:.2g}"
        parts.append(f"95 % of the visible surface within {share} % of the diagonal")
    if empty is not None:
        parts.append(f"{100 * empty:.0f} % protrudes")
    return parts


def _summarize(numbers: Numbers) -> str:
    """Return a text with the numbers of the shape from CoACD.

    If CoACD failed, return an empty text, because the reason for the outcome already names the shape.
    """
    if "instead" in numbers:
        return ""
    return ", ".join((format_count(numbers["parts"], "part"), *_list_measures(numbers)))


TASKS = (
    Task(
        "collision",
        "Collision shape",
        (Attempt("coacd", ("coacd", "igl"), _decompose),),
        _judge,
        _summarize,
        powers={"volume": 3, "distance_mean": 1, "distance_95": 1},
        fallbacks=(
            Attempt("manifold3d", ("manifold3d", "igl"), _make_hull),
            Attempt("pymeshlab", ("pymeshlab", "igl"), _decimate),
        ),
        prepare=_prepare,
        picture=draw_side_by_side,
        needs_images=True,
    ),
)
