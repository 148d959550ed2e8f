"""The SH colours that an official exporter writes, from an asset's buffers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.asset.sh import SH_C0, sh_basis

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset


def evaluate_sh(asset: Asset, directions: NDArray[np.float32], degree: int) -> NDArray[np.float32]:
    """Return the sum of the harmonics of `asset` up to `degree`, without the 0.5 that makes it a colour.

    Parameters
    ----------
    asset : Asset
        With `f_dc`, and `f_rest` for a degree above 0, both (n, ...).
    directions : (n, 3) float32
        Unit vectors, from the camera to the primitive, world axes.

    Returns
    -------
    (n, 3) float32
    """
    total = np.float32(SH_C0) * asset.buffers["f_dc"]
    if degree > 0:
        rest = _coefficients(asset)
        for number, value in enumerate(sh_basis(directions, degree)):
            total = total + value[:, None] * rest[:, number]
    return np.asarray(total)


def _coefficients(asset: Asset) -> NDArray[np.float32]:
    """Return `f_rest` as (n, K, 3) whatever its order in the buffer; a view."""
    flat = asset.buffers["f_rest"]
    if asset.manifest.appearance["f_rest_order"] == "coefficient_major":
        return flat.reshape(len(flat), -1, 3)
    return flat.reshape(len(flat), 3, -1).transpose(0, 2, 1)
