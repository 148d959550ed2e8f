"""Collision shapes of foreign meshes, which need not be closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msb.delivery.collision_kinds import CollisionKind, parse_collision
from msb.delivery.collision_shapes import cut_convex, make_patch_hulls, measure_protrusion
from msb.delivery.hulls import PointsAndFaces, fit_box
from msb.delivery.surface_distance import Floats, Ints, measure_distances, sample_surface
from msb.lod.report import Shape
from msb.lod.simplification import merge_places, simplify_arrays

# Faces of the surface that hulls are cut from, and of the one that distances are measured to. On a statue of
# 2,000 faces V-HACD took 4 s and CoACD 190 s on busy cores; both shapes were 1.3 % from the surface, and 37 %
# and 51 % of their area in mid-air. V-HACD is therefore tried first.
_CUT_FACES, _MEASURED_FACES = 2000, 50_000
# Time limit of CoACD in seconds.
SECONDS = 120.0


@dataclass(frozen=True, eq=False)
class Collision:
    """A shape: its parts in the unit of the asset, and its report."""

    parts: list[PointsAndFaces]
    report: Shape


def make_collision(points: Floats, faces: Ints, kind: str, seconds: float = SECONDS) -> Collision:
    """Return a collision shape of this kind for a surface (V, 3), (F, 3).

    "mesh:N" is the surface itself with about N faces; it is open where the surface is. "hulls:N" are up to N
    convex parts by V-HACD, else by CoACD, else hulls of patches. "box" is one box of any orientation.

    Raises
    ------
    UsageError
        USAGE: the kind is invalid. EXTRA_MISSING.
    """
    requested, count = parse_collision(kind)
    low, high = points[faces].min(axis=(0, 1)), points[faces].max(axis=(0, 1))
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    unit, joined = merge_places((points - middle) / size, faces)
    # A simpler surface for the cuts and for the measurement.
    budgets = [_MEASURED_FACES, _CUT_FACES, *([count] if requested == "mesh" else [])]
    reduced = dict(zip(budgets, simplify_arrays(unit, joined, budgets), strict=True))
    measured, cut = (_select(unit, reduced[n], joined, n) for n in (_MEASURED_FACES, _CUT_FACES))
    parts, why = _make_parts(requested, count, measured, cut, unit, reduced.get(count, joined), seconds)
    starts = np.cumsum([0, *(len(corners) for corners, _ in parts)])
    shape = (
        np.concatenate([corners for corners, _ in parts]),
        np.concatenate([rows + start for (_, rows), start in zip(parts, starts[:-1], strict=True)]),
    )
    distance = float(measure_distances(sample_surface(*measured)[0], *shape).mean())
    protruding = measure_protrusion(parts, shape, measured)
    placed = [(middle + size * corners, rows) for corners, rows in parts]
    report = Shape(None, requested, len(shape[1]), len(parts), distance, protruding, why or None)
    return Collision(placed, report)


def _select(points: np.ndarray, faces: Ints, whole: Ints, budget: int) -> PointsAndFaces:
    """Return the vertices that faces use, and the faces; the whole surface if it is within the budget."""
    faces = whole if len(whole) <= budget or not len(faces) else faces
    used, number = np.unique(faces, return_inverse=True)
    return points[used].astype(np.float64), number.reshape(-1, 3).astype(np.int64)


def _make_parts(
    requested: CollisionKind,
    count: int,
    measured: PointsAndFaces,
    cut: PointsAndFaces,
    points: np.ndarray,
    mesh: Ints,
    seconds: float,
) -> tuple[list[PointsAndFaces], str]:
    """Return the parts of a shape, and the reason if they were not made in the first way."""
    if requested == "box":
        return [fit_box(measured[0])], ""
    if requested == "mesh":
        return [_select(points, mesh, mesh, count)], ""
    if count == 1:
        return make_patch_hulls(cut, 1), ""
    parts, why = cut_convex(*cut, count, seconds, by_voxels=True)
    return parts or make_patch_hulls(measured, count), why
