"""The SH colours that an official exporter writes, from an asset's buffers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.asset.activation import rest_coefficients
from msb.asset.sh import SH_C0, sh_basis

if TYPE_CHECKING:
    from msb.asset import Asset


def evaluate_sh(asset: Asset, directions: NDArray[np.float32], degree: int) -> NDArray[np.float32]:
    """Return the sum (n, 3) of the harmonics up to `degree`, without the 0.5 that makes it a colour.

    `directions` (n, 3) are unit vectors from the camera to the primitive, in world axes.
    """
    total = np.float32(SH_C0) * asset.buffers["f_dc"]
    if degree > 0:
        rest = rest_coefficients(asset)
        for number, value in enumerate(sh_basis(directions, degree)):
            total = total + value[:, None] * rest[:, number]
    return np.asarray(total)
