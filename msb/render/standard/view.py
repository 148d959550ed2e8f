"""The record of a camera for the opaque z-buffer's kernels: 51 floats, laid out as zbuffer_math.cl says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from msb.scenes import Camera

UNITS = 4096
"""Steps per pixel of the grid that corners are snapped to; equals UNIT in zbuffer_math.cl."""


def standard_view(camera: Camera) -> NDArray[np.float32]:
    """Return the record of a camera, (51,) float32, computed in float64.

    The centre of the camera is split into its nearest float32 and a rest, so that a camera far from the
    world's origin loses no precision. The kernels subtract the first part before they rotate a point; the
    rest is rotated here, and the kernels add it afterwards.
    """
    rotation = camera.world_to_camera[:3, :3]
    inverse = camera.camera_to_world[:3, :3]  # not the transpose: rotations are orthonormal to 1e-4 only
    rounded = camera.center.astype(np.float32).astype(np.float64)
    rest = camera.center - rounded
    scale = np.array([camera.fx * UNITS, camera.fy * UNITS])
    rows = rotation * np.append(scale, 1.0)[:, None]
    # A ray's direction in the world, for a camera x, y, z of (u - cx) / fx, (v - cy) / fy, 1.
    ray = inverse.T / np.array([camera.fx, camera.fy, 1.0])[:, None]
    principal = np.array([camera.cx, camera.cy])
    with np.errstate(over="ignore"):
        low, ray_low = (
            part - part.astype(np.float32) for part in (rows, ray)
        )  # for what is computed in double
    parts = (rows, rounded, -rows @ rest, principal * UNITS + 0.5, scale, rest, ray, principal, low, ray_low)
    with np.errstate(over="ignore"):  # a camera 1e39 away sees nothing
        return np.concatenate([part.reshape(-1) for part in parts]).astype(np.float32)
