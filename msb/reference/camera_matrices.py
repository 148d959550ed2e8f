"""From the one camera of the package to the matrices each method's official code makes of it.

The package's camera has OpenCV axes and pixel centres at half-integers. What upstream reads are angles of
view or an intrinsic matrix; going back through them reproduces its float32 matrices (docs/reference.md says
what remains).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.reference.arithmetic import Reals, matrix_product
from msb.scenes import Camera


@dataclass(frozen=True)
class SplattingCamera:
    """What the three splatting rasterizers are given, for a raster of `width` x `height` samples.

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
        Pixels by which the principal point lies right of and below the middle of the raster. Upstream
        ignores it; here it is added to every pixel position, which changes nothing when it is 0.
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
    """Return `camera` as the 3DGS family sees it.

    Parameters
    ----------
    near, far : float
        Planes of the projection; they act on its z row alone.
    dtype : numpy.float32 or numpy.float64
        float32: every matrix is rounded as upstream does, the product P W is formed in float32.
    scale : int
        Samples per pixel along each axis: the raster is `scale` times as large, angles stay.

    Notes
    -----
    Formulas: GaodeRender/triangle-splatting: src/diff_recon/utils/camera.py;
    trianglesplatting/triangle-splatting: utils/graphics_utils.py, scene/cameras.py. The centre is upstream's
    float32 inverse of W; here the inverse is taken in double and rounded, since its last bits depend on the
    linear algebra library. Upstream's Triangle-Splatting and MeshSplatting invert W twice in double before
    rounding, which is the identity up to 1e-16 and is left out.
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
        center=np.linalg.inv(world_to_camera.astype(np.float64))[:3, 3].astype(dtype),  # noqa: TID251 - its own arithmetic
        tan_fov=np.array([tan_x, tan_y], dtype),
        shift=np.array([scale * shift[0], scale * shift[1]], dtype),
    )
