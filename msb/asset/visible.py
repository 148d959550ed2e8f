"""Which faces a method's opacity threshold leaves on the standard tier."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset.reader import Asset


def visible_faces(asset: Asset) -> NDArray[np.bool_] | None:
    """Return which faces (F,) an STE threshold leaves, None if the asset has no threshold.

    A face is hidden unless its opacity is above the threshold; both are float32, as in the official code
    (GaodeRender/triangle-splatting). DESIGN: hidden faces are dropped on the standard tier.
    """
    stored = asset.manifest.settings.get("ste_threshold")
    if stored is None or stored.value is None or "opacity" not in asset.buffers:
        return None
    return np.asarray(sigmoid(asset.buffers["opacity"]) > np.float32(stored.value))


def sigmoid(logits: Any) -> NDArray[np.float32]:
    """Return 1 / (1 + exp(-x)), evaluated in float64 and rounded to float32."""
    with np.errstate(over="ignore"):
        return np.asarray(1 / (1 + np.exp(-np.asarray(logits, np.float64)))).astype(np.float32)
