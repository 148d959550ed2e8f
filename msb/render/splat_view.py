"""What the splatting kernels are told of a camera: one record, laid out as `View` in splat_common.cl."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.scenes import Camera

TILE = 16

VIEW = np.dtype(
    [
        ("world_to_camera", np.float32, 12),
        ("full", np.float32, 16),
        ("center", np.float32, 3),
        ("tan_fov", np.float32, 2),
        ("shift", np.float32, 2),
        ("power", np.float32),
        ("sigma", np.float32),
        ("width", np.uint32),
        ("height", np.uint32),
        ("columns", np.uint32),
        ("rows", np.uint32),
        ("degree", np.uint32),
        ("rest_stride", np.uint32),
        ("back_culling", np.uint32),
        ("broadcast_z", np.uint32),
        ("tile_rule", np.uint32),
    ]
)
"""The members of `View`; each has four bytes, so there is no padding on any side."""


def make_view(camera: Camera, near: float, far: float, scale: int, fields: Mapping[str, Any]) -> NDArray[Any]:
    """Return the record for a raster of `scale` times as many samples along each axis as `camera` has pixels.

    Parameters
    ----------
    near, far : float
        Planes of the projection; they act on its z row alone.
    fields : mapping
        The members that do not depend on the camera.

    Notes
    -----
    The 3DGS family projects with tan(fov / 2) and the float32 product P W, whose elements are summed from
    first to last. The centre is that of the float32 W, taken in double and rounded: the last bits of
    upstream's float32 inverse depend on the linear algebra library. Upstream ignores the principal point;
    its distance from the middle of the image is added to sample positions, which changes nothing where it
    is 0. Sources: GaodeRender/triangle-splatting: src/diff_recon/utils/camera.py;
    trianglesplatting/triangle-splatting: utils/graphics_utils.py, scene/cameras.py.
    """
    view = np.zeros((), VIEW)
    tan_x, tan_y = math.tan(camera.fov_x / 2), math.tan(camera.fov_y / 2)
    projection = np.zeros((4, 4), np.float32)
    projection[0, 0] = 2 * near / (2 * (tan_x * near))
    projection[1, 1] = 2 * near / (2 * (tan_y * near))
    projection[2, 2] = far / (far - near)
    projection[2, 3] = -(far * near) / (far - near)
    projection[3, 2] = 1
    world_to_camera = camera.world_to_camera.astype(np.float32)
    full = projection[:, :1] * world_to_camera[:1]
    for k in range(1, 4):  # no matrix product: a BLAS fuses and reorders
        full = full + projection[:, k : k + 1] * world_to_camera[k : k + 1]
    view["world_to_camera"] = world_to_camera[:3].ravel()
    view["full"] = full.ravel()
    view["center"] = np.linalg.inv(world_to_camera.astype(np.float64))[:3, 3]
    view["tan_fov"] = tan_x, tan_y
    view["shift"] = scale * (camera.cx - camera.width / 2), scale * (camera.cy - camera.height / 2)
    view["width"], view["height"] = scale * camera.width, scale * camera.height
    view["columns"], view["rows"] = -(-scale * camera.width // TILE), -(-scale * camera.height // TILE)
    for name, value in fields.items():
        view[name] = value
    return view
