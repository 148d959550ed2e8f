"""The matrices that each method's official code derives from a camera.

`msb.Camera` has OpenCV axes and pixel centres at half-integers. Some official code reads angles of view;
other official code reads an intrinsic matrix. This module converts a camera to both forms, and reproduces the
official float32 matrices. Remaining differences are described in docs/reference.md.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.reference.arithmetic import Reals, matrix_product
from msb.scenes import Camera


@dataclass(frozen=True)
class SplattingCamera:
    """Inputs of the splatting rasterizers for a raster of `width` x `height` samples.

    Attributes
    ----------
    world_to_camera : (4, 4)
        W, for column vectors: x right, y down, z forward.
    full_projection : (4, 4)
        P W: homogeneous clip coordinates, w = camera z.
    center : (3,)
        The camera's position in the world.
    tan_fov : (2,)
        tan(fov / 2) in x and y.
    shift : (2,)
        Offset of the principal point from the middle of the raster, to the right and down, in samples.
        The official code ignores the shift. This renderer adds the shift to every sample position; a shift of
        0 has no effect.
    """

    width: int
    height: int
    world_to_camera: Reals
    full_projection: Reals
    center: Reals
    tan_fov: Reals
    shift: Reals


def splatting_camera(
    camera: Camera, near: float, far: float, dtype: type[Any], scale: int = 1
) -> SplattingCamera:
    """Return `camera` in the conventions of the 3DGS family.

    Parameters
    ----------
    near, far : float
        Near and far plane of the projection in scene units, which affect only the projection's z row.
    dtype : numpy.float32 or numpy.float64
        float32: every matrix is rounded as in the official code, and the product P W is computed in float32.
    scale : int
        Samples per pixel along each axis. The raster is `scale` times as large, and the angles of view are
        unchanged.

    Notes
    -----
    Formulas: GaodeRender/triangle-splatting: src/diff_recon/utils/camera.py;
    trianglesplatting/triangle-splatting: utils/graphics_utils.py, scene/cameras.py. The official code gets
    the camera centre from a float32 inverse of W. This module computes the inverse in double precision and
    rounds it. The last bits of the official inverse depend on the linear algebra library. The official code
    of Triangle-Splatting and MeshSplatting inverts W twice in double precision before rounding. The second
    inversion changes W by less than 1e-16 and is omitted here.
    """
    tan_x, tan_y = math.tan(camera.fov_x / 2), math.tan(camera.fov_y / 2)
    projection = np.zeros((4, 4), dtype)
    projection[0, 0] = 2 * near / (2 * (tan_x * near))
    projection[1, 1] = 2 * near / (2 * (tan_y * near))
    projection[2, 2] = far / (far - near)
    projection[2, 3] = -(far * near) / (far - near)
    projection[3, 2] = 1
    world_to_camera = camera.world_to_camera.astype(dtype)
    shift = (camera.cx - camera.width / 2, camera.cy - camera.height / 2)
    return SplattingCamera(
        width=scale * camera.width,
        height=scale * camera.height,
        world_to_camera=world_to_camera,
        full_projection=matrix_product(projection, world_to_camera),
        center=np.linalg.inv(world_to_camera.astype(np.float64))[:3, 3].astype(dtype),  # noqa: TID251 - independent of the code under test
        tan_fov=np.array([tan_x, tan_y], dtype),
        shift=np.array([scale * shift[0], scale * shift[1]], dtype),
    )
