"""A collision shape by CoACD: how many convex parts, how far from what cameras see, and what it blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msb.trial.geometry import random_colors, signed_volume
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Task, counted, graded, worst

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.trial.look import Look
    from msb.trial.task import Numbers

NEAR, FAR = 0.02, 0.05
"""Distance from the visible surface to the shape that 95 % keep, of the bounds' diagonal."""
LITTLE, MUCH = 0.1, 0.3
"""Share of the shape's volume that some camera sees to be empty: what one bumps into in mid-air."""
TOLERANCE = 0.01
"""How far before the surface, of the diagonal, a point of the shape must be to count as in mid-air."""
_POINTS = 20_000
"""Points of the visible surface, and of the shape's volume."""


def _prepare(_: TriedMesh, look: Look) -> dict[str, NDArray[Any]]:
    points = look.visible_points(_POINTS)
    return {} if points is None else {"visible": points}


def _work(mesh: TriedMesh, _: Mapping[str, Any], given: Mapping[str, NDArray[Any]]) -> Made:
    import coacd
    import igl

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
    if "visible" in given and len(given["visible"]):
        squares = igl.point_mesh_squared_distance(given["visible"].astype(np.float64), points, faces)[0]
        distances = np.sqrt(squares)
        numbers["distance_mean"] = float(distances.mean())
        numbers["distance_95"] = float(np.quantile(distances, 0.95))
    label = np.repeat(np.arange(len(parts)), sizes)
    shape = TriedMesh(points, faces, random_colors(label))
    inside = points_inside(parts, np.asarray(volumes), _POINTS)
    return Made(numbers, {"shape": shape}, {"inside": inside})


def points_inside(
    parts: list[tuple[Any, Any]], volumes: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return `count` points (count, 3), evenly over the volume of convex parts, the same every time.

    A part falls into the tetrahedra between its middle and its faces; in each, four exponential numbers over
    their sum are even barycentric coordinates.
    """
    rng = np.random.default_rng(0)
    found = []
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
        found.append(np.einsum("nk,nki->ni", weights[:, :3], chosen) + weights[:, 3:] * middle)
    return np.concatenate(found) if found else np.zeros((0, 3))


def _shares(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    total = float(sizes.sum())
    return sizes / total if total > 0 else np.full(len(sizes), 1 / len(sizes))


def _judge(mesh: TriedMesh, made: Mapping[str, Made], look: Look) -> Judgement:
    one = made["coacd"]
    diagonal = mesh.diagonal
    far = one.numbers.get("distance_95")
    empty = look.empty_share(one.arrays["inside"], TOLERANCE * diagonal)
    numbers = {
        **one.numbers,
        "distance_95_of_diagonal": far / diagonal if far is not None and diagonal else None,
        "empty_share": empty,
    }
    relative = numbers["distance_95_of_diagonal"]
    reasons = []
    if graded(relative, NEAR, FAR) != "works":
        reasons.append(f"5 % of what is seen is {100 * relative:.1f} % of the size or more away from it")
    if graded(empty, LITTLE, MUCH) != "works":
        reasons.append(f"{100 * (empty or 0):.0f} % of it is where nothing is seen")
    outcome = worst((graded(relative, NEAR, FAR), graded(empty, LITTLE, MUCH)))
    return Judgement(outcome, "; ".join(reasons) or None, numbers)


def _says(numbers: Numbers) -> str:
    relative, empty = numbers["distance_95_of_diagonal"], numbers["empty_share"]
    text = counted(numbers["parts"], "part")
    if relative is not None:
        text += f", 95 % within {100 * relative:.2g} % of the size"
    return text + ("" if empty is None else f", {100 * empty:.0f} % in mid-air")


def _picture(_: TriedMesh, made: Mapping[str, Made], look: Look) -> NDArray[Any] | None:
    return look.picture(made["coacd"].meshes["shape"])


TASKS = (
    Task(
        "collision",
        "Collision shape",
        (Attempt("coacd", ("coacd", "igl"), _work),),
        _judge,
        _says,
        powers={"volume": 3, "distance_mean": 1, "distance_95": 1},
        prepare=_prepare,
        picture=_picture,
    ),
)
