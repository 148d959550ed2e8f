"""Static colours and visible faces: what an asset shows when it is drawn as an opaque mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from msb.asset.sh import SH_C0
from msb.asset.visible import sigmoid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset

WHITE = (1.0, 1.0, 1.0)
"""Of a mesh that brings no colour, as in glTF."""


@dataclass(frozen=True)
class StaticColors:
    """Colours of the standard tier.

    Attributes
    ----------
    values : (n, 3) or (n, 4) uint8 or float32
        Floats are in [0, 1]; a fourth channel is not used.
    domain : {"vertex", "face", "corner"}
    """

    values: NDArray[Any]
    domain: Literal["vertex", "face", "corner"]


def static_colors(asset: Asset) -> StaticColors:
    """Return the colours `asset` brings, or clamp(C0 f_dc + 0.5, 0, 1), or white.

    Each colour is clamped before anything is interpolated (paper, "Standard deployment").
    """
    for name in ("color", "f_dc"):
        if name not in asset.buffers:
            continue
        values, domain = asset.buffers[name], asset.manifest.buffers[name].domain
        if name == "f_dc":
            values = np.float32(SH_C0) * values.reshape(len(values), -1) + np.float32(0.5)
        if values.dtype.kind == "f":
            values = np.clip(values, np.float32(0), np.float32(1))
        return StaticColors(values, domain)  # type: ignore[arg-type]
    return StaticColors(np.full((asset.manifest.face_count, 3), WHITE, np.float32), "face")


def shown_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.uint32] | None:
    """Return the faces an STE threshold leaves, in ascending order; None if that is all of them.

    As in the official code (GaodeRender/triangle-splatting) a face is shown if its opacity is above the
    threshold, both in float32.
    """
    if ste_threshold is None or "opacity" not in asset.buffers:
        return None
    shown = sigmoid(asset.buffers["opacity"].reshape(-1)) > np.float32(ste_threshold)
    if shown.all():
        return None
    return np.flatnonzero(shown).astype(np.uint32)
