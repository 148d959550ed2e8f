"""A collision shape by CoACD: how many convex parts, how far from what cameras see, and what it blocks.

Where CoACD gives none, a convex hull is made, which moving things can have, and a mesh of fewer faces, for
what stands still.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import face_areas, signed_volume
from msb.topology.hulls import HULL_CORNERS, hull_directions
from msb.trial.renderings import Look, random_colors
from msb.trial.mesh import TriedMesh
from msb.trial.task import OUTCOMES, Attempt, Judgement, Made, Numbers, Task, counted, graded, judged, worst
from msb.trial.tasks.decimate import beside, by_pymeshlab

# Largest distance from the visible surface to the shape for 95 % of the points, relative to the diagonal.
NEAR, FAR = 0.02, 0.05
# Share of the shape's volume that cameras see to be empty.
LITTLE, MUCH = 0.1, 0.3
TOLERANCE = 0.01  # distance in front of the surface, relative to the diagonal, from which a point is outside
_POINTS = 20_000  # sample points of the visible surface, and of the shape's volume
_PERCENT = 10  # faces of the substitute mesh, in percent of the mesh's


def _prepare(_: TriedMesh, look: Look) -> dict[str, NDArray[Any]]:
    points = look.visible_points(_POINTS)
    return {} if points is None else {"visible": points}


def _coacd(mesh: TriedMesh, given: Arrays) -> Made:
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices.astype(np.float64), mesh.faces.astype(np.int32)))
    if not parts:
        raise ValueError("it gives no part")
    sizes = [len(points) for points, _ in parts]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    points = np.concatenate([np.asarray(one, np.float64) for one, _ in parts])
    faces = np.concatenate(
        [np.asarray(one, np.int64) + start for (_, one), start in zip(parts, starts, strict=True)]
    )
    volumes = [abs(signed_volume(np.asarray(own), np.asarray(rows, np.int64))) for own, rows in parts]
    numbers: Numbers = {"parts": len(parts), "faces": len(faces), "volume": float(sum(volumes))}
    label = np.repeat(np.arange(len(parts)), sizes)
    shape = TriedMesh(points, faces, random_colors(label))
    inside = points_inside(parts, np.asarray(volumes), _POINTS)
    return Made(numbers | _distances(shape, given), {"shape": shape}, {"inside": inside})


def _hull(mesh: TriedMesh, given: Arrays) -> Made:
    import manifold3d

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
    shape = TriedMesh(points, faces, random_colors(np.zeros(len(points), np.int64)))
    inside = points_inside([(points, faces)], np.array([volume]), _POINTS)
    return Made(numbers | _distances(shape, given), {"hull": shape}, {"inside": inside})


def _fewer_faces(mesh: TriedMesh, given: Arrays) -> Made:
    import igl

    shape = by_pymeshlab(mesh, {}, percent=_PERCENT).meshes["mesh"]
    if not len(shape.faces):
        raise ValueError("no face is left")
    # What one bumps into is a surface: points even over it, of which those far from the mesh are in mid-air.
    rng = np.random.default_rng(0)
    corners = shape.vertices[
        shape.faces[
            rng.choice(len(shape.faces), _POINTS, p=_shares(face_areas(shape.vertices, shape.faces)[0]))
        ]
    ]
    weights = rng.exponential(size=(_POINTS, 3))
    on_it = np.einsum("nk,nki->ni", weights / weights.sum(axis=1, keepdims=True), corners)
    away = np.sqrt(igl.point_mesh_squared_distance(on_it, mesh.vertices.astype(np.float64), mesh.faces)[0])
    empty = float(np.count_nonzero(away > TOLERANCE * mesh.diagonal) / _POINTS)
    numbers: Numbers = {"faces": len(shape.faces), "empty_share": empty}
    return Made(numbers | _distances(shape, given), {"mesh": shape})


def _distances(shape: TriedMesh, given: Arrays) -> Numbers:
    """Return how far the points of the visible surface are from a shape, if there are any."""
    import igl

    if not len(given.get("visible", ())):
        return {}
    squares = igl.point_mesh_squared_distance(
        given["visible"].astype(np.float64), shape.vertices, shape.faces
    )[0]
    distances = np.sqrt(squares)
    return {"distance_mean": float(distances.mean()), "distance_95": float(np.quantile(distances, 0.95))}


def points_inside(
    parts: list[tuple[Any, Any]], volumes: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return `count` points (count, 3), evenly over the volume of convex parts, the same every time.

    A part falls into the tetrahedra between its middle and its faces; in each, four exponential numbers over
    their sum are even barycentric coordinates.
    """
    rng = np.random.default_rng(0)
    sampled = []
    for number, (points, faces) in zip(rng.multinomial(count, _shares(volumes)), parts, strict=True):
        if not number:
            continue
        points, faces = np.asarray(points, np.float64), np.asarray(faces, np.int64)
        corners = points[faces]
        middle = points.mean(axis=0)
        sizes = np.abs(
            np.einsum("fi,fi->f", corners[:, 0] - middle, np.cross(*(corners[:, k] - middle for k in (1, 2))))
        )
        chosen = corners[rng.choice(len(faces), number, p=_shares(sizes))]
        weights = rng.exponential(size=(number, 4))
        weights /= weights.sum(axis=1, keepdims=True)
        sampled.append(np.einsum("nk,nki->ni", weights[:, :3], chosen) + weights[:, 3:] * middle)
    return np.concatenate(sampled) if sampled else np.zeros((0, 3))


def _shares(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    total = float(sizes.sum())
    return sizes / total if total > 0 else np.full(len(sizes), 1 / len(sizes))


def _judge(mesh: TriedMesh, made: Mapping[str, Made], look: Look) -> Judgement:
    shapes = {library: _judged(mesh, one, look) for library, one in made.items()}
    best = min(shapes, key=lambda library: OUTCOMES.index(shapes[library].outcome))
    own = shapes[best]
    if best == "coacd":
        return own
    kinds = {"manifold3d": "hull of {}{}", "pymeshlab": "mesh of {} for what stands still{}"}
    parts = [
        "a " + kinds[library].format(counted(one.numbers["faces"], "face"), _bracketed(one.numbers))
        for library, one in shapes.items()
    ]
    why = f"{' and '.join(parts)} {'stands' if len(parts) == 1 else 'stand'} in"
    why += f"; of the {kinds[best].split()[0]}, {own.why}" if own.why else ""
    numbers = {**own.numbers, "best": best, "instead": {name: one.numbers for name, one in shapes.items()}}
    return Judgement(worst((own.outcome, "care")), why, numbers)


def _judged(mesh: TriedMesh, one: Made, look: Look) -> Judgement:
    """Return the judgement of one shape."""
    diagonal = mesh.diagonal
    far = one.numbers.get("distance_95")
    relative = far / diagonal if far is not None and diagonal else None
    inside = one.arrays.get("inside")
    empty = one.numbers["empty_share"] if inside is None else look.empty_share(inside, TOLERANCE * diagonal)
    away = f"5 % of what is seen is {100 * (relative or 0):.1f} % of the size or more away from it"
    in_air = f"{100 * (empty or 0):.0f} % of it is where nothing is seen"
    numbers = {**one.numbers, "distance_95_of_diagonal": relative, "empty_share": empty}
    return judged(numbers, (graded(relative, NEAR, FAR), away), (graded(empty, LITTLE, MUCH), in_air))


def _bracketed(numbers: Numbers) -> str:
    parts = _near_and_empty(numbers)
    return f" ({', '.join(parts)})" if parts else ""


def _near_and_empty(numbers: Numbers) -> list[str]:
    relative, empty = numbers["distance_95_of_diagonal"], numbers["empty_share"]
    parts = []
    if relative is not None:
        share = "less than 0.01" if relative < 1e-4 else f"{100 * relative:.2g}"
        parts.append(f"95 % within {share} % of the size")
    if empty is not None:
        parts.append(f"{100 * empty:.0f} % of it in mid-air")
    return parts


def _says(numbers: Numbers) -> str:
    """Return the numbers of CoACD's shape; what stands in for it is said with why it does."""
    if "instead" in numbers:
        return ""
    return ", ".join((counted(numbers["parts"], "part"), *_near_and_empty(numbers)))


TASKS = (
    Task(
        "collision",
        "Collision shape",
        (Attempt("coacd", ("coacd", "igl"), _coacd),),
        _judge,
        _says,
        powers={"volume": 3, "distance_mean": 1, "distance_95": 1},
        instead=(
            Attempt("manifold3d", ("manifold3d", "igl"), _hull),
            Attempt("pymeshlab", ("pymeshlab", "igl"), _fewer_faces),
        ),
        prepare=_prepare,
        picture=beside,
        by_look=True,
    ),
)
