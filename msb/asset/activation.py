"""Activation functions of stored parameters.

Renderers, face selection by STE threshold, and official exports use these functions. The reference renderers
have their own code for these functions. Tests compare these functions with the reference renderers.
"""

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset


def sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 / (1 + exp(-x)). Each operation is rounded to float32, as in torch.

    Rounding a float64 result once would give a different float32 value for some logits. If an STE threshold
    lies between the two values, different faces are hidden. Infinite logits give the opacities 0 and 1.
    """
    with np.errstate(over="ignore"):
        return np.asarray(1 / (1 + exponential(-np.asarray(logits, np.float32))))


def exponential(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return exp(x), computed in float64 and rounded to float32."""
    with np.errstate(over="ignore"):
        return np.exp(x, dtype=np.float64).astype(np.float32)


def rest_coefficients(asset: Asset) -> NDArray[np.float32]:
    """Return a view of `f_rest` with the shape (n, K, 3): K coefficients, then 3 channels."""
    flat = asset.buffers["f_rest"]
    if asset.manifest.appearance.get("f_rest_order") == "coefficient_major":
        return flat.reshape(len(flat), -1, 3)
    return flat.reshape(len(flat), 3, -1).transpose(0, 2, 1)
