"""DiffSoup's matrices of a camera, rounded where the official code rounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.planes import invert_projection

if TYPE_CHECKING:
    from msb.scenes import Camera


def diffsoup_matrices(
    camera: Camera, layout: str, near: float, far: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return DiffSoup's MVP = P V and its inverse.

    Parameters
    ----------
    camera : Camera
        The camera, with OpenCV axes in both layouts.
    layout : {"colmap", "synthetic"}
        "colmap": V negates the camera's z, NDC y grows downwards, and cy enters with upstream's sign, the
        opposite of the true one. "synthetic": V negates y and z, NDC y grows upwards; upstream has the
        principal point in the middle, here it is honoured.
    near, far : float
        Camera depths, scene units, that become NDC -1 and 1.

    Returns
    -------
    mvp, inverse : (4, 4) float32
        Matrices for column vectors (x, y, z, 1); clip w is the camera's z.

    Notes
    -----
    Formulas: kenji-tojo/diffsoup: examples/utils.py ("colmap", from a float32 K, in float32),
    examples/02_synthetic.py ("synthetic", in double, then rounded). The product is summed from first to last,
    as upstream's on a CPU. The inverse is taken in double and rounded: the last bits of upstream's float32
    inverse depend on its linear algebra library.
    """
    real: Any = np.float32 if layout == "colmap" else np.float64
    width, height, two, one = real(camera.width), real(camera.height), real(2), real(1)
    fx, fy, cx, cy = real(camera.fx), real(camera.fy), real(camera.cx), real(camera.cy)
    projection = np.zeros((4, 4), np.float32)
    projection[0, 0] = two * fx / width
    projection[1, 1] = two * fy / height
    projection[0, 2] = one - two * (cx / width)
    projection[1, 2] = two * (cy / height) - one
    projection[3, 2] = -1
    near, far = np.float64(near), np.float64(far)  # what cannot be divided is refused below
    with np.errstate(all="ignore"):
        projection[2, 2] = (far + near) / (near - far)
        projection[2, 3] = 2 * far * near / (near - far)
    signs = (1, 1, -1, 1) if layout == "colmap" else (1, -1, -1, 1)
    view = (np.diag(signs) @ camera.world_to_camera).astype(np.float32)
    with np.errstate(all="ignore"):
        mvp = projection[:, :1] * view[0]
        for k in range(1, 4):  # not @: a BLAS fuses and reorders
            mvp = mvp + projection[:, k : k + 1] * view[k]
    return mvp, invert_projection(mvp, near, far)


def pixel_centers(size: int, padded: int) -> NDArray[np.float32]:
    """Return the NDC coordinates of the centres of `size` pixels, then zeros; (padded,) in all."""
    centers = np.zeros(padded, np.float32)
    centers[:size] = np.float32(-1) + np.float32(2) * (
        np.arange(size, dtype=np.float32) + np.float32(0.5)
    ) / np.float32(size)
    return centers
