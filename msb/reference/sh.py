"""Colours from spherical harmonics, evaluated in the order of the official kernels."""

import numpy as np

from msb.asset.sh import SH_C0, sh_basis
from msb.reference.arithmetic import Reals, norm


def colors_from_sh(coefficients: Reals, points: Reals, center: Reals, degree: int) -> Reals:
    """Return the colour max(0.5 + sum_i B_i(d) k_i, 0) of coefficients k_i in direction d.

    The colour can exceed 1.

    Parameters
    ----------
    coefficients : (n, 1 + K, 3)
        Coefficients k of the basis functions B. Coefficients above `degree` are ignored.
    points : (n, 3)
        Points p in the world that define the view directions.
    center : (3,)
        The camera's position c. The direction d = (p - c) / |p - c| points away from the camera.

    Returns
    -------
    (n, 3)
    """
    offsets = points - center
    directions = offsets / norm(offsets)[:, None]
    color = SH_C0 * coefficients[:, 0]
    for number, value in enumerate(sh_basis(directions, degree), start=1):
        color = color + value[:, None] * coefficients[:, number]
    return np.maximum(color + 0.5, 0)
