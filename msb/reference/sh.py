"""Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS."""

from __future__ import annotations

import numpy as np

from msb.reference.arithmetic import Reals, norm

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def basis(directions: Reals, degree: int) -> list[Reals]:
    """Return B_1 .. B_K, K = (degree + 1)^2 - 1, of unit vectors (..., 3); each has the shape (...).

    Source: GaodeRender/triangle-splatting: submodules/diff-triangle-rasterization-2D/src/forward.cu; the
    other methods have the same formulas in the same order of operations.
    """
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    values: list[Reals] = []
    if degree > 0:
        values += [-C1 * y, C1 * z, -C1 * x]
    xx, yy, zz = x * x, y * y, z * z
    xy, yz, xz = x * y, y * z, x * z
    if degree > 1:
        values += [
            C2[0] * xy,
            C2[1] * yz,
            C2[2] * (2 * zz - xx - yy),
            C2[3] * xz,
            C2[4] * (xx - yy),
        ]
    if degree > 2:
        values += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * xy * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    return values


def colors_from_sh(coefficients: Reals, points: Reals, center: Reals, degree: int) -> Reals:
    """Return max(0.5 + sum_k B_k(d) k_k, 0) with d = (p - c) / |p - c|: no upper clamp.

    Parameters
    ----------
    coefficients : (n, 1 + K, 3)
        Coefficients above `degree` are ignored.
    points : (n, 3)
        Points in the world at which, or towards which, the colour is seen.
    center : (3,)
        The camera's position: d points away from it.

    Returns
    -------
    (n, 3)
    """
    offsets = points - center
    directions = offsets / norm(offsets)[:, None]
    color = C0 * coefficients[:, 0]
    for number, value in enumerate(basis(directions, degree), start=1):
        color = color + value[:, None] * coefficients[:, number]
    return np.maximum(color + 0.5, 0)
