"""Cameras off the path of a capture: a flight that stops beside its cameras, and cameras between them."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from msb.scenes.camera import Camera
from msb.scenes.paths import interpolated

# Frames from one stop to the next: a second of film.
PACE = 24
_STOPS = 10
# Of a gap between cameras: where several are alike, the last bit does not choose.
_DIGITS = 6
# Where the stops lie, by the axes of their cameras: to the right, nearer, to the left, farther, above.
_ASIDE = ((1, 0, 0), (0, 0, 1), (-1, 0, 0), (0, 0, -1), (0, -1, 0))


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


def between(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return at most `count` cameras more, each halfway between two of `cameras` or of those made before.

    Each next one is the farthest from every other of those halfway between two neighbours, so that the widest
    gaps are closed first. Two are neighbours if none is nearer to halfway between them, and one is turned by
    less than 120 degrees to become the other: on a way half round an object nobody may have stood. How far
    apart two are is the angle between their axes, in radians, and the distance of their centres in radii of
    the capture. There are fewer cameras where those given are alone, stand together, or opposite.
    """
    aim = looked_at(cameras)
    every = list(cameras)
    radius = radius_of(cameras) or 1.0
    while len(every) < len(cameras) + count:
        poses = np.stack([camera.world_to_camera for camera in every])
        turns = poses[:, :3, :3]
        # The trace of the rotation from one to the other is 1 + 2 cos of its angle.
        pairs = np.argwhere(np.triu(np.einsum("mij,nij->mn", turns, turns) > 0, 1))
        halfway = _halfway(poses[pairs[:, 0]], poses[pairs[:, 1]], aim)
        gaps = _gaps(halfway, poses, radius)
        widest = gaps.min(axis=1)
        widest[widest < np.take_along_axis(gaps, pairs, axis=1).min(axis=1)] = 0  # they are no neighbours
        if not widest.any():
            break
        best = int(widest.argmax())
        lens = interpolated([every[number] for number in pairs[best]], 3)[1]
        name = f"between_{len(every) - len(cameras):05d}"
        every.append(replace(lens, world_to_camera=halfway[best], name=name, image_path=None, split=None))
    return every[len(cameras) :]


def _halfway(
    ones: NDArray[np.float64], others: NDArray[np.float64], aim: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the poses (N, 4, 4) halfway between two each, on an arc round `aim` where both look towards it.

    The point that lies as far before them as `aim` moves along a line, and so does its distance from them.
    Where `aim` is behind them, as in a room, they move along it themselves.
    """
    left, _, right = np.linalg.svd(ones[:, :3, :3] + others[:, :3, :3])
    made = ones.copy()
    made[:, :3, :3] = left @ right
    away = np.zeros(len(made))
    seen = np.zeros((len(made), 3))
    for pose in (ones, others):
        far = np.maximum(pose[:, 2, :3] @ aim + pose[:, 2, 3], 0)
        away += far / 2
        seen += (_centers(pose) + far[:, None] * pose[:, 2, :3]) / 2
    center = seen - away[:, None] * made[:, 2, :3]
    made[:, :3, 3] = -np.einsum("nij,nj->ni", made[:, :3, :3], center)
    return made


def _centers(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where cameras stand, (N, 3)."""
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def _gaps(ones: NDArray[np.float64], others: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Return how far apart the poses of two sets are, (N, M)."""
    turned = np.arccos((ones[:, 2, :3] @ others[:, 2, :3].T).clip(-1, 1))
    moved = np.linalg.norm(_centers(ones)[:, None] - _centers(others), axis=2)
    return np.asarray((turned + moved / radius).round(_DIGITS))
