"""Additional cameras without photographs: a camera flight beside a capture's cameras, and cameras in gaps."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from msb.scenes.camera import Camera
from msb.scenes.paths import interpolate_cameras

# Number of frames between two stops of the camera flight. At 24 frames per second, this is one second of
# video.
PACE = 24
# Largest number of stops of the camera flight.
_STOPS = 10
# Number of decimals to which gaps between cameras are rounded. Because of rounding, equal gaps compare as
# equal.
_DIGITS = 6
# Displacements of successive stops of the flight in camera axes: right, nearer, left, farther, up.
_ASIDE = ((1, 0, 0), (0, 0, 1), (-1, 0, 0), (0, 0, -1), (0, -1, 0))


def make_walk(
    stops: Sequence[Camera], capture: Sequence[Camera], frames: int, reach: float, size: int
) -> list[Camera]:
    """Return the first `frames` cameras of a closed flight between and beyond the capture's cameras.

    The camera flight passes at most ten of `stops`, evenly spread, in their order. Each stop is displaced by
    `reach` times the radius of the `capture`: the largest distance of a camera from the mean of all cameras.
    The direction of displacement alternates: right, nearer, left, farther, up. Each displaced camera is
    rotated towards the point nearest to all camera axes, so that this point keeps its place in the image. The
    camera flight takes 24 frames from stop to stop (`interpolate_cameras`). If `frames` exceeds one loop of
    the camera flight, the flight starts again.

    Parameters
    ----------
    stops, capture : sequence of Camera
        At least two cameras along the flight, and all cameras of the capture.
    frames : int
    reach : float
    size : int
        Longer side of the images in pixels; images are never larger than at the first stop.

    Raises
    ------
    SceneError
        CAMERA_PATH, as in `interpolate_cameras`.
    """
    chosen = [stops[k * len(stops) // _STOPS] for k in range(_STOPS)] if len(stops) > _STOPS else stops
    offset = reach * measure_radius(capture)
    aim = find_target(capture)
    keys = [
        _move(camera.scaled(min(1.0, size / max(camera.width, camera.height))), offset * np.array(side), aim)
        for camera, side in zip(chosen, cycle(_ASIDE), strict=False)
    ]
    around = interpolate_cameras(keys, PACE * len(keys), closed=True)
    return [around[frame % len(around)] for frame in range(frames)]


def measure_radius(cameras: Sequence[Camera]) -> float:
    """Return the largest distance of a camera from the mean of all cameras."""
    centers = np.stack([camera.center for camera in cameras])
    return float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())


def find_target(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """Return the point (3,) with the smallest sum of squared distances from the axes of all cameras."""
    centers = np.stack([camera.center for camera in cameras])
    axes = np.stack([camera.camera_to_world[:3, 2] for camera in cameras])
    # Compute projections (n, 3, 3) perpendicular to the axes. The point solves a 3 x 3 linear system.
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = centers.mean(axis=0)
    pulls = np.einsum("nij,nj->i", across, centers - middle)
    # If all axes are parallel, the pseudo-inverse does not move the point along them.
    return np.asarray(middle + np.linalg.pinv(across.sum(axis=0), rcond=1e-3) @ pulls)


def _move(camera: Camera, offset: NDArray[np.float64], aim: NDArray[np.float64]) -> Camera:
    """Return a camera moved by `offset` along its axes.

    The camera is rotated so that `aim` keeps its place in the image.
    """
    pose = camera.world_to_camera.copy()
    before = pose[:3, :3] @ aim + pose[:3, 3]
    pose[:3, 3] -= offset
    after = before - offset
    if min(before[2], after[2]) > 0:
        pose[:3] = (
            _rotation_between(after / np.linalg.norm(after), before / np.linalg.norm(before)) @ pose[:3]
        )
    return replace(camera, world_to_camera=pose)


def _rotation_between(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest rotation (3, 3) that turns `start` into `end`, less than a half-turn away."""
    x, y, z = np.cross(start, end)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + start @ end))


def fill_gaps(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return at most `count` additional cameras, each halfway between two neighbours.

    Neighbours can also be cameras that an earlier step added. Two cameras are neighbours if no other camera
    is nearer to the pose halfway between them. The rotations of neighbours must differ by less than 120
    degrees. The limit of 120 degrees avoids straight paths through an object. Each step adds the halfway pose
    that is farthest from its nearest camera. The widest gaps are therefore filled first. The distance of two
    cameras is the angle between their axes in radians, plus the distance of their centres divided by the
    radius of the capture. If no neighbours remain, the result has fewer cameras. For example, a single camera
    or two opposite cameras have no neighbours.
    """
    aim = find_target(cameras)
    every = list(cameras)
    radius = measure_radius(cameras) or 1.0
    while len(every) < len(cameras) + count:
        poses = np.stack([camera.world_to_camera for camera in every])
        turns = poses[:, :3, :3]
        # The trace of the rotation between two cameras is 1 + 2 cos(angle), which is positive below 120
        # degrees.
        pairs = np.argwhere(np.triu(np.einsum("mij,nij->mn", turns, turns) > 0, 1))
        # Compute the distances (pairs, cameras) of all halfway poses to all cameras. Two cameras are
        # neighbours if no other camera is nearer to their halfway pose.
        halfway = _interpolate_halfway(poses[pairs[:, 0]], poses[pairs[:, 1]], aim)
        gaps = _measure_gaps(halfway, poses, radius)
        widest = gaps.min(axis=1)
        widest[widest < np.take_along_axis(gaps, pairs, axis=1).min(axis=1)] = 0  # not neighbours
        if not widest.any():
            break
        best = int(widest.argmax())
        lens = interpolate_cameras([every[number] for number in pairs[best]], 3)[1]
        name = f"between_{len(every) - len(cameras):05d}"
        every.append(replace(lens, world_to_camera=halfway[best], name=name, image_path=None, split=None))
    return every[len(cameras) :]


def _interpolate_halfway(
    starts: NDArray[np.float64], ends: NDArray[np.float64], aim: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the poses (N, 4, 4) halfway between the poses `starts` and `ends`.

    If both cameras look at `aim`, the halfway pose lies on an arc around `aim`. Each camera defines a point
    in front of it, at the depth of `aim`. The halfway pose uses the mean point and the mean depth of both
    cameras. If `aim` is behind the cameras, as in a room, the halfway pose lies on the straight line between
    the cameras.
    """
    # The mean rotation is the orthogonal matrix nearest to the sum of both rotations.
    left, _, right = np.linalg.svd(starts[:, :3, :3] + ends[:, :3, :3])
    halfway = starts.copy()
    halfway[:, :3, :3] = left @ right
    # Compute the mean depth of the points in front of the cameras, and the mean position of the points.
    away = np.zeros(len(halfway))
    seen = np.zeros((len(halfway), 3))
    for pose in (starts, ends):
        far = np.maximum(pose[:, 2, :3] @ aim + pose[:, 2, 3], 0)
        away += far / 2
        seen += (_centers(pose) + far[:, None] * pose[:, 2, :3]) / 2
    center = seen - away[:, None] * halfway[:, 2, :3]
    halfway[:, :3, 3] = -np.einsum("nij,nj->ni", halfway[:, :3, :3], center)
    return halfway


def _centers(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions of cameras with these poses, (N, 3)."""
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def _measure_gaps(
    firsts: NDArray[np.float64], seconds: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Return the pose distances (N, M) between two sets of cameras."""
    turned = np.arccos((firsts[:, 2, :3] @ seconds[:, 2, :3].T).clip(-1, 1))
    moved = np.linalg.norm(_centers(firsts)[:, None] - _centers(seconds), axis=2)
    return np.asarray((turned + moved / radius).round(_DIGITS))
