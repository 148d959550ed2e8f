"""Real spherical harmonics in the order and with the signs of 3DGS, as official exporters evaluate them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msb.meshes.assets import SH_C0

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset

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
    if degree == 0:
        return np.asarray(total)
    rest = coefficients(asset)
    x, y, z = (directions[:, axis, None] for axis in range(3))
    for number, basis in enumerate(_basis(x, y, z)[: (degree + 1) ** 2 - 1]):
        total = total + basis * rest[:, number]
    return np.asarray(total)


def coefficients(asset: Asset) -> NDArray[np.float32]:
    """Return `f_rest` as (n, K, 3) whatever its order in the buffer; a view."""
    flat = asset.buffers["f_rest"]
    if asset.manifest.appearance["f_rest_order"] == "coefficient_major":
        return flat.reshape(len(flat), -1, 3)
    return flat.reshape(len(flat), 3, -1).transpose(0, 2, 1)


def _basis(x: Any, y: Any, z: Any) -> list[Any]:
    f = np.float32
    xx, yy, zz = x * x, y * y, z * z
    xy, yz, xz = x * y, y * z, x * z
    return [
        -f(_C1) * y,
        f(_C1) * z,
        -f(_C1) * x,
        f(_C2[0]) * xy,
        f(_C2[1]) * yz,
        f(_C2[2]) * (f(2) * zz - xx - yy),
        f(_C2[3]) * xz,
        f(_C2[4]) * (xx - yy),
        f(_C3[0]) * y * (f(3) * xx - yy),
        f(_C3[1]) * xy * z,
        f(_C3[2]) * y * (f(4) * zz - xx - yy),
        f(_C3[3]) * z * (f(2) * zz - f(3) * xx - f(3) * yy),
        f(_C3[4]) * x * (f(4) * zz - xx - yy),
        f(_C3[5]) * z * (xx - yy),
        f(_C3[6]) * x * (xx - f(3) * yy),
    ]
