"""A walk off the path of a capture: a flight that stops beside its cameras and never at one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from msb.scenes.camera import Camera
from msb.scenes.paths import interpolated

PACE = 24
"""Frames from one stop to the next: a second of film."""
_STOPS = 10
_ASIDE = ((1, 0, 0), (0, 0, 1), (-1, 0, 0), (0, 0, -1), (0, -1, 0))
"""Where the stops lie, by the axes of their cameras: to the right, nearer, to the left, farther, above."""


def walk(
    stops: Sequence[Camera], capture: Sequence[Camera], frames: int, reach: float, size: int
) -> list[Camera]:
    """Return the first `frames` cameras of a closed flight between and beyond the cameras of a capture.

    It goes by at most ten of `stops`, evenly spread, in their order. Each stop is moved aside by `reach`
    times the radius of the `capture`, the largest distance of a camera from the middle of all, in turn to
    its right, nearer, to its left, farther and above. It turns so that what all the cameras look at, the
    point nearest to their axes, stays where it was in the picture. The way to the next stop takes 24 frames
    (`interpolated`); a walk that is longer than one round goes round again.

    Parameters
    ----------
    stops, capture : sequence of Camera
        The cameras to go by, at least two, and all cameras.
    frames : int
    reach : float
    size : int
        Longer side of the pictures in pixels; they are never larger than those of the first stop.

    Raises
    ------
    SceneError
        CAMERA_PATH, as of `interpolated`.
    """
    chosen = [stops[k * len(stops) // _STOPS] for k in range(_STOPS)] if len(stops) > _STOPS else stops
    offset = reach * radius_of(capture)
    aim = looked_at(capture)
    keys = [
        _moved(camera.scaled(min(1.0, size / max(camera.width, camera.height))), offset * np.array(side), aim)
        for camera, side in zip(chosen, cycle(_ASIDE), strict=False)
    ]
    around = interpolated(keys, PACE * len(keys), closed=True)
    return [around[frame % len(around)] for frame in range(frames)]


def radius_of(cameras: Sequence[Camera]) -> float:
    """Return the largest distance of a camera from the middle of all."""
    centers = np.stack([camera.center for camera in cameras])
    return float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())


def looked_at(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """Return the point (3,) whose squared distances from the axes of all cameras have the least sum."""
    centers = np.stack([camera.center for camera in cameras])
    axes = np.stack([camera.camera_to_world[:3, 2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = centers.mean(axis=0)
    pulls = np.einsum("nij,nj->i", across, centers - middle)
    # Where all axes are parallel, the point is not moved along them.
    return np.asarray(middle + np.linalg.pinv(across.sum(axis=0), rcond=1e-3) @ pulls)


def _moved(camera: Camera, offset: NDArray[np.float64], aim: NDArray[np.float64]) -> Camera:
    """Return a camera moved by `offset` along its axes, and turned to `aim` where that is in front of it."""
    pose = camera.world_to_camera.copy()
    before = pose[:3, :3] @ aim + pose[:3, 3]
    pose[:3, 3] -= offset
    after = before - offset
    if min(before[2], after[2]) > 0:
        pose[:3] = _turn(after / np.linalg.norm(after), before / np.linalg.norm(before)) @ pose[:3]
    return replace(camera, world_to_camera=pose)


def _turn(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least rotation (3, 3) that takes one direction to another, less than a half-turn away."""
    x, y, z = np.cross(start, end)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + start @ end))
