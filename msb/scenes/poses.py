"""Poses: rigid 4 x 4 matrices between the world and a camera, and their rotations.

Matrices multiply column vectors: x_camera = W x_world. Camera axes follow OpenCV: x right, y down, z forward.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.base.matrices import inverse
from msb.errors import SceneError, shorten

# Limits for the error of a rotation R, the largest entry of |R R^T - I|. Below the first limit, R is stored
# unchanged. Up to the second limit, R is replaced by the nearest rotation. After a few inversions, the error
# of a float32 pose is still well below the first limit. Matrices with four decimals have an error of at most
# 1.8e-4, which is below the second limit.
EXACT_ROTATION_ERROR, MAX_ROTATION_ERROR = 1e-4, 2e-4

# Largest coordinate in scene units. The square of a larger distance does not fit into float32, the precision
# of renderers.
MAX_COORDINATE = 1e18

_OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
_OPENGL_AXES.setflags(write=False)


def check_pose(matrix: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return `matrix` as a new array (4, 4) float64 if it consists of a rotation and a translation.

    Error messages call the matrix `what`.
    """
    pose = _finite_matrix(matrix, what)
    if (pose[3] != (0, 0, 0, 1)).any():
        row = " ".join(f"{entry:g}" for entry in pose[3])
        text = f"{what} has the last row {row}; it must be 0 0 0 1: the translation is a column"
        raise SceneError("CAMERA_INVALID", text, pointer="[3]")
    if (far := float(np.abs(pose[:3, 3]).max())) > MAX_COORDINATE:
        text = f"{what} translates by {far:g}; the limit is {MAX_COORDINATE:g}"
        raise SceneError("CAMERA_INVALID", text)
    rotation = pose[:3, :3]
    small = float(np.abs(rotation).max()) < 2  # products of larger entries may overflow
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max()) if small else math.inf
    if error > MAX_ROTATION_ERROR:
        by = f"by {error:.3g}" if small else "by more than 1"
        text = (
            f"the rotation of {what} is not orthonormal: R R^T differs from the identity {by}; "
            f"at most {MAX_ROTATION_ERROR:g} is allowed"
        )
        raise SceneError("CAMERA_INVALID", text)
    if np.linalg.det(rotation) < 0:
        text = f"the rotation of {what} is mirrored (determinant -1); the determinant must be +1"
        raise SceneError("CAMERA_INVALID", text)
    if error > EXACT_ROTATION_ERROR:
        left, _, right = np.linalg.svd(rotation)
        pose[:3, :3] = left @ right
    return pose


def _finite_matrix(matrix: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return `matrix` as a new array (4, 4) float64 of finite numbers."""
    given = np.asarray(matrix)
    if given.shape != (4, 4) or given.dtype.kind not in "fiu":
        text = f"{what} is an array of {given.dtype} of shape {given.shape}; it must be 4 x 4 numbers"
        raise SceneError("CAMERA_INVALID", shorten(text, 200))
    pose = given.astype(np.float64) + 0.0  # turns -0.0 into 0.0, so that equal poses have equal bytes
    for row, column in np.argwhere(~np.isfinite(pose)).tolist():
        text = f"{what}[{row}, {column}] is {pose[row, column]}; it must be finite"
        raise SceneError("CAMERA_INVALID", text, pointer=f"[{row}, {column}]")
    return pose


def invert_pose(pose: ArrayLike, what: str = "the camera-to-world matrix") -> NDArray[np.float64]:
    """Return the inverse (4, 4) float64 of a pose.

    The function converts world-to-camera to camera-to-world, and vice versa.
    """
    return rigid_inverse(check_pose(pose, what))


def rigid_inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a valid pose.

    The 3 x 3 block is inverted as a matrix, as in official loaders. If a pose was rounded to float32, the
    inverse of its rotation differs from the transpose.
    """
    back = np.eye(4)
    back[:3, :3] = inverse(pose[:3, :3])
    back[:3, 3] = -back[:3, :3] @ pose[:3, 3]
    return back


def from_opengl(camera_to_world: ArrayLike, what: str = "the camera-to-world matrix") -> NDArray[np.float64]:
    """Return the world-to-camera matrix (4, 4) float64 of an OpenGL or Blender camera.

    `camera_to_world` has camera axes x right, y up, z backward, like NeRF's `transform_matrix` and Blender's
    `matrix_world`. The world axes are unchanged. Columns 1 and 2 are negated, then the matrix is inverted
    (`graphdeco-inria/gaussian-splatting`: scene/dataset_readers.py).
    """
    return rigid_inverse(check_pose(camera_to_world, what) @ _OPENGL_AXES)


def look_at_pose(eye: ArrayLike, target: ArrayLike, up: ArrayLike) -> NDArray[np.float64]:
    """Return the world-to-camera matrix (4, 4) of a camera at `eye` that looks at `target`.

    `up` is the world direction that points up in the image, of any length.
    """
    position, aim, upward = vector3("eye", eye), vector3("target", target), vector3("up", up)
    forward = _unit(aim - position)
    if forward is None:
        text = "eye and target are the same point; they must differ"
        raise SceneError("CAMERA_PATH", text)
    across = _unit(upward)
    right = None if across is None else _unit(np.cross(forward, across), least=1e-6)
    if right is None:
        text = "up is zero or parallel to the line from eye to target; choose another direction"
        raise SceneError("CAMERA_PATH", text)
    # Rows of the rotation: right, down and forward in the world.
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ position
    return pose


def vector3(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return `value` as (3,) float64."""
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not (np.abs(vector) <= MAX_COORDINATE).all():
        text = f"{name} is {shorten(repr(value))}; it must be three numbers of at most {MAX_COORDINATE:g}"
        raise SceneError("CAMERA_PATH", text)
    return vector


def _unit(vector: NDArray[np.float64], least: float = 0.0) -> NDArray[np.float64] | None:
    """Return `vector` scaled to length 1. If the length is at most `least`, return None."""
    length = math.hypot(*vector)
    return vector / length if length > least else None


def rotation_from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z) of any length except 0.

    Source: Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985, section 3.
    """
    w, x, y, z = np.asarray(quaternion, dtype=np.float64) / math.hypot(*np.asarray(quaternion))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix (3, 3) as (4,) float64. The sign of the
    quaternion is arbitrary.

    The quaternion is the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix. The eigenvector
    computation is stable for all rotation angles. If the matrix is not exactly a rotation, the nearest
    rotation is used. Source: Bar-Itzhack, New method for extracting the quaternion from a rotation
    matrix, Journal of Guidance 23(6), 2000.
    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, dtype=np.float64)
    symmetric = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    quaternion: NDArray[np.float64] = np.linalg.eigh(symmetric)[1][:, -1]
    return quaternion
