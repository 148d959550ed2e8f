"""Real spherical harmonics up to degree 4, in the order and with the signs of 3DGS."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.floating[Any]]

SH_C0 = 0.28209479177387814
"""Spherical harmonic of degree 0, 1 / (2 sqrt(pi)). The paper rounds the value to 0.28209."""
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
_C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)
_C4 = (
    2.5033429417967046,
    -1.7701307697799304,
    0.9461746957575601,
    -0.6690465435572892,
    0.10578554691520431,
    -0.6690465435572892,
    0.47308734787878004,
    -1.7701307697799304,
    0.6258357354491761,
)


def sh_basis(directions: Reals, degree: int) -> list[Reals]:
    """Return the basis functions B_1 .. B_K at unit vectors (..., 3), with K = (degree + 1)^2 - 1.

    Each of the K arrays of basis functions has the shape (...). Source: GaodeRender/triangle-splatting:
    submodules/diff-triangle-rasterization-2D/src/forward.cu. All methods use these formulas for degrees 1 to
    3, in this order of operations. Source of degree 4: nerfstudio-project/gsplat at 90d7b4b
    (gsplat/cuda/_torch_impl.py). The constants are those of the real spherical harmonics with the
    Condon-Shortley phase.
    """
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    values: list[Reals] = []
    if degree > 0:
        values += [-_C1 * y, _C1 * z, -_C1 * x]
    xx, yy, zz = x * x, y * y, z * z
    xy, yz, xz = x * y, y * z, x * z
    if degree > 1:
        values += [
            _C2[0] * xy,
            _C2[1] * yz,
            _C2[2] * (2 * zz - xx - yy),
            _C2[3] * xz,
            _C2[4] * (xx - yy),
        ]
    if degree > 2:
        values += [
            _C3[0] * y * (3 * xx - yy),
            _C3[1] * xy * z,
            _C3[2] * y * (4 * zz - xx - yy),
            _C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            _C3[4] * x * (4 * zz - xx - yy),
            _C3[5] * z * (xx - yy),
            _C3[6] * x * (xx - 3 * yy),
        ]
    if degree > 3:
        values += [
            _C4[0] * xy * (xx - yy),
            _C4[1] * yz * (3 * xx - yy),
            _C4[2] * xy * (7 * zz - 1),
            _C4[3] * yz * (7 * zz - 3),
            _C4[4] * (zz * (35 * zz - 30) + 3),
            _C4[5] * xz * (7 * zz - 3),
            _C4[6] * (xx - yy) * (7 * zz - 1),
            _C4[7] * xz * (xx - 3 * yy),
            _C4[8] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return values
