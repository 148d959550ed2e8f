"""DiffSoup's matrices of a camera for its reference, in the dtype that was asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msb.asset.planes import invert_projection
from msb.reference.arithmetic import Reals, matrix_product

if TYPE_CHECKING:
    from msb.scenes import Camera


def diffsoup_projection(
    camera: Camera, layout: str, near: float, far: float, dtype: type[Any]
) -> tuple[Reals, Reals]:
    """Return DiffSoup's MVP and its inverse, (4, 4) each, for column vectors.

    Parameters
    ----------
    layout : {"colmap", "synthetic"}
        "colmap": NDC y grows downwards, and the vertical principal point enters with upstream's sign, the
        opposite of the true one. "synthetic": NDC y grows upwards; upstream centres the principal point,
        here it is honoured.
    near, far : float
        Camera depths that become NDC -1 and 1.

    Notes
    -----
    P = [2fx/W 0 1-2cx/W 0; 0 2fy/H 2cy/H-1 0; 0 0 (f+n)/(n-f) 2fn/(n-f); 0 0 -1 0] and MVP = P V in `dtype`.

    "colmap" (kenji-tojo/diffsoup: examples/utils.py): V is W with its z row negated; P is computed in float32
    from a float32 K. "synthetic" (examples/02_synthetic.py): V is W with its y and z rows negated; P is
    computed in double and rounded. The inverse is taken in double and rounded, since the last bits of
    upstream's float32 inverse depend on the linear algebra library.
    """
    real = dtype if layout == "colmap" else np.float64
    width, height, two = real(camera.width), real(camera.height), real(2)
    fx, fy, cx, cy = real(camera.fx), real(camera.fy), real(camera.cx), real(camera.cy)
    projection = np.zeros((4, 4), dtype)
    projection[0, 0] = two * fx / width
    projection[1, 1] = two * fy / height
    projection[0, 2] = real(1) - two * (cx / width)
    projection[1, 2] = two * (cy / height) - real(1)
    near, far = np.float64(near), np.float64(far)  # what cannot be divided is refused below
    projection[2, 2] = (far + near) / (near - far)
    projection[2, 3] = (2 * far * near) / (near - far)
    projection[3, 2] = -1
    signs = (1, 1, -1, 1) if layout == "colmap" else (1, -1, -1, 1)
    view = (np.diag(signs) @ camera.world_to_camera).astype(dtype)
    mvp = matrix_product(projection, view)
    return mvp, invert_projection(mvp, near, far)
