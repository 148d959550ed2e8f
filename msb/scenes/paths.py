"""Camera paths: turntables around an object, and smooth flights through given cameras."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.poses import (
    MAX_COORDINATE,
    look_at_pose,
    quaternion_from_rotation,
    rotation_from_quaternion,
    vector3,
)

# Largest number of frames of a camera path: ten hours at 29 frames per second. A larger number is probably a
# typing error.
MAX_FRAMES = 1 << 20


def turntable(
    center: ArrayLike,
    radius: float,
    *,
    up: ArrayLike,
    count: int,
    width: int,
    height: int,
    fov_y: float,
    elevation: float = 0.0,
) -> list[Camera]:
    """Return cameras on a circle that look at the circle's centre.

    Parameters
    ----------
    center : (3,) array_like
        The point in the world that the cameras look at.
    radius : float
        Distance of each camera from `center`.
    up : (3,) array_like
        The axis of the turntable, which is up in the images.
    count : int
        Number of cameras. The cameras have equal angles and are counter-clockwise as seen from above. The
        first camera is in the direction of the world axis that is closest to perpendicular to `up`. If
        several axes are equally suitable, x is preferred.
    width, height : int
        Size of the images in pixels.
    fov_y : float
        Full vertical angle in radians.
    elevation : float
        Angle of the cameras above the plane through `center`, in radians, within (-pi/2, pi/2).

    Raises
    ------
    SceneError
        CAMERA_PATH: the radius, the count or the elevation is out of range, `center` or `up` is not a vector,
        or `up` is zero. The errors of `Camera` are raised too.
    """
    middle, axis = vector3("center", center), vector3("up", up)
    length = math.hypot(*axis)
    if not length > 0:
        raise SceneError("CAMERA_PATH", "up is zero; it must be a vector with a direction")
    if not 0 < radius <= MAX_COORDINATE:
        raise SceneError("CAMERA_PATH", f"the radius is {radius}; it must be positive")
    if not abs(elevation) < math.pi / 2:
        text = f"the elevation is {elevation}; it must be between -pi/2 and pi/2 radians"
        raise SceneError("CAMERA_PATH", text)
    axis = axis / length
    # Compute an orthonormal basis of the circle's plane.
    start = np.eye(3)[np.argmin(np.round(np.abs(axis), 6))]
    start = start - axis * (start @ axis)
    start /= math.hypot(*start)
    side = np.cross(axis, start)
    cameras = []
    _check_frames(count)
    for index in range(count):
        angle = 2 * math.pi * index / count
        outward = math.cos(angle) * start + math.sin(angle) * side
        eye = middle + radius * (math.cos(elevation) * outward + math.sin(elevation) * axis)
        pose = look_at_pose(eye, middle, axis)
        camera = Camera.from_fov(width, height, pose, fov_y=fov_y, name=f"turntable_{index:05d}")
        cameras.append(replace(camera, unit=unit_at(radius)))
    return cameras


def unit_at(distance: float) -> float:
    """Return the unit of depth (`Camera.unit`) for an object at `distance`.

    For ordinary distances, the unit of depth is 1, so results do not change. For other distances, the unit of
    depth is a power of two, so no rounding errors occur.
    """
    return 1.0 if 0.5 <= distance <= 64 else 2.0 ** (round(math.log2(distance)) - 1)


def interpolate_cameras(cameras: Sequence[Camera], count: int, *, closed: bool = False) -> list[Camera]:
    """Return a smooth flight through two or more cameras: `count` cameras of the size of the first camera.

    All segments between two cameras take the same time, whatever their length is. An open camera flight
    begins at the first camera and ends at the last camera. A `closed` camera flight is a loop: after its last
    frame, the flight returns to the first camera. The velocity and the angular velocity are continuous.

    Centres follow the uniform Catmull-Rom spline (Catmull and Rom, A class of local interpolating
    splines, 1974). Beyond its ends, an open camera flight continues with mirrored cameras. Rotations follow
    the same spline of unit quaternions, with signs aligned and the result normalised. Between two cameras,
    the rotation is spherical linear interpolation (slerp). Focal lengths and principal points are
    interpolated linearly, which cannot overshoot.
    """
    if len(cameras) < 2:
        text = f"a flight needs at least 2 cameras, not {len(cameras)}"
        raise SceneError("CAMERA_PATH", text)
    # Collect centres (n, 3), rotations as quaternions (n, 4) and intrinsics (n, 4) of the given cameras.
    keys = [camera.resized(cameras[0].width, cameras[0].height) for camera in cameras]
    centers = np.stack([key.center for key in keys])
    turns = _align_signs(np.stack([quaternion_from_rotation(key.camera_to_world[:3, :3]) for key in keys]))
    lenses = np.array([(key.fx, key.fy, key.cx, key.cy) for key in keys])
    _check_frames(count)
    end = len(keys) if closed else len(keys) - 1
    flight = []
    for index, time in enumerate(np.linspace(0, end, num=count, endpoint=not closed).tolist()):
        # Interpolate within the segment at a position from 0 to 1.
        segment = min(int(time), end - 1)
        at = time - segment
        pose = np.eye(4)
        turn = _catmull_rom(_align_signs(_spline_keys(turns, segment, closed)), at)
        pose[:3, :3] = rotation_from_quaternion(turn).T
        pose[:3, 3] = -pose[:3, :3] @ _catmull_rom(_spline_keys(centers, segment, closed), at)
        fx, fy, cx, cy = (1 - at) * lenses[segment] + at * lenses[(segment + 1) % len(keys)]
        name = f"flight_{index:05d}"
        flight.append(replace(keys[0], fx=fx, fy=fy, cx=cx, cy=cy, world_to_camera=pose, name=name))
    return flight


def _check_frames(count: int) -> None:
    """Raise CAMERA_PATH if a path cannot have `count` frames."""
    if not 1 <= count <= MAX_FRAMES:
        raise SceneError("CAMERA_PATH", f"the count is {count}; it must be from 1 to {MAX_FRAMES}")


def _spline_keys(keys: NDArray[np.float64], segment: int, closed: bool) -> NDArray[np.float64]:
    """Return the two ends of `segment` with the keys before and after them, (4, D)."""
    if closed:
        return keys[np.arange(segment - 1, segment + 3) % len(keys)]
    before = keys[segment - 1] if segment else 2 * keys[0] - keys[1]
    beyond = keys[segment + 2] if segment + 2 < len(keys) else 2 * keys[-1] - keys[-2]
    return np.stack([before, keys[segment], keys[segment + 1], beyond])


def _align_signs(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions whose signs give neighbours a non-negative dot product.

    A quaternion and its negative are the same rotation. With aligned signs, the interpolation takes the
    shorter way.
    """
    rows = quaternions.copy()
    for before, row in itertools.pairwise(rows):
        if before @ row < 0:
            row *= -1
    return rows


def _catmull_rom(keys: NDArray[np.float64], at: float) -> NDArray[np.float64]:
    """Return the value (D,) of a Catmull-Rom spline. `at` is 0 at keys[1] and 1 at keys[2]."""
    cube, square = at**3, at**2
    weights = np.array(
        [
            -cube + 2 * square - at,
            3 * cube - 5 * square + 2,
            -3 * cube + 4 * square + at,
            cube - square,
        ]
    )
    value: NDArray[np.float64] = weights / 2 @ keys
    return value
