"""Initial triangles at the points of a scene, tangent to the surface through the points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msb.asset.sh import SH_C0

if TYPE_CHECKING:
    from msb.scenes import Camera

_NEIGHBOURS = 8


def chosen(
    points: NDArray[np.float64], colors: NDArray[np.float64], count: int, random: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return at most `count` distinct points and their colours."""
    _, first = np.unique(points.round(9), axis=0, return_index=True)
    if len(first) > count:
        first = random.choice(first, count, replace=False)
    first.sort()
    return points[first], colors[first]


def spread_out(
    points: NDArray[np.float64], spacing: NDArray[np.float32], count: int, random: np.random.Generator
) -> NDArray[np.int64]:
    """Return the indices of at most `count` points (N, 3), evenly spread relative to `spacing` (N,).

    Farthest-point sampling: each point is the farthest from all previous ones.
    """
    taken = [int(random.integers(len(points)))]
    nearest = np.full(len(points), np.inf)
    while len(taken) < min(count, len(points)):
        away = np.square(points - points[taken[-1]]).sum(axis=1) / np.square(spacing)
        nearest = np.minimum(nearest, away)
        taken.append(int(nearest.argmax()))
    return np.sort(np.array(taken))


def fit_planes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation (N, 3, 3) at each point: columns are the axes of the neighbours, longest first."""
    _, near = cKDTree(points).query(points, min(_NEIGHBOURS + 1, len(points)))
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(around.transpose(0, 2, 1) @ around)
    axes = np.ascontiguousarray(axes[:, :, ::-1])
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]
    return axes


def triangles_at(
    points: NDArray[np.float64], scale: float, random: np.random.Generator
) -> NDArray[np.float64]:
    """Return an equilateral triangle at each point, (N, 3, 3), in the plane of its neighbours.

    Its circumradius is `scale` times the mean distance to the three nearest points.
    """
    distances, _ = cKDTree(points).query(points, min(_NEIGHBOURS + 1, len(points)))
    axes = fit_planes(points)
    size = scale * distances[:, 1:4].mean(axis=1)
    turn = random.uniform(0, 2 * np.pi, len(points))[:, None] + np.arange(3) * (2 * np.pi / 3)
    first, second = axes[:, :, 0], axes[:, :, 1]
    arms = np.cos(turn)[..., None] * first[:, None] + np.sin(turn)[..., None] * second[:, None]
    return np.asarray(points[:, None] + size[:, None, None] * arms)


def color_coefficients(colors: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the SH coefficients of degree 0, (N, 1, 3), for colours (N, 3)."""
    return ((colors - 0.5) / SH_C0).astype(np.float32)[:, None]


def pixel_sizes(points: NDArray[np.float64], cameras: Sequence[Camera]) -> NDArray[np.float32]:
    """Return the smallest pixel size of any camera at points (N, 3), in scene units."""
    best = np.full(len(points), np.inf)
    for camera in cameras:
        seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        z = seen[:, 2]
        with np.errstate(all="ignore"):
            x, y = np.abs(seen[:, 0] / z) * camera.fx, np.abs(seen[:, 1] / z) * camera.fy
        # Include a margin around the image.
        inside = (z > 0.05) & (x < 0.6 * camera.width) & (y < 0.6 * camera.height)
        best = np.where(inside, np.minimum(best, z / camera.fx), best)
    usual = np.median(best[np.isfinite(best)]) if np.isfinite(best).any() else 1e-3
    return np.where(np.isfinite(best), best, usual).astype(np.float32)
