"""The buffers of an asset, converted to activated parameters for the reference renderers.

Opening an asset checks only the shapes of its buffers, so this module checks their values.
"""

from typing import Any

import numpy as np

from msb.asset import Asset
from msb.asset.activation import rest_coefficients
from msb.asset.drawable import require, required_buffer
from msb.errors import AssetError
from msb.reference.arithmetic import Reals, sigmoid


def number(asset: Asset, section: str, key: str) -> float:
    """Return a number from a section of the manifest; raise TRIASSET_FIELD for any other value."""
    value = getattr(asset.manifest, section).get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        text = f"{section}.{key} is {value!r:.40}; it must be a number"
        raise AssetError("TRIASSET_FIELD", text, file=asset.path, pointer=f"/{section}/{key}")
    return value


def opacities(asset: Asset, rows: int, dtype: type[Any]) -> Reals:
    """Return 1 / (1 + exp(-logit)) of the stored logits, (rows,). Infinite logits give 0 and 1."""
    require(asset, "opacity", "encoding", "logit")
    return sigmoid(required_buffer(asset, "opacity", rows).astype(dtype))


def triangles(asset: Asset, dtype: type[Any]) -> Reals:
    """Return the corners of every face, (F, 3 corners, 3)."""
    return np.asarray(asset.buffers["positions"].astype(dtype)[asset.buffers["indices"]])


def sh_coefficients(asset: Asset, rows: int, dtype: type[Any]) -> Reals:
    """Return all stored SH coefficients, (rows, 1 + K, 3); coefficient 0 is `f_dc`."""
    first = required_buffer(asset, "f_dc", rows, 3)
    degree = asset.manifest.sh_degree
    if degree == 0:
        return first.astype(dtype)[:, None]
    required_buffer(asset, "f_rest", rows, 3 * ((degree + 1) ** 2 - 1))
    return np.concatenate([first[:, None], rest_coefficients(asset)], axis=1, dtype=dtype)
