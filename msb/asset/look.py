"""The standard look: the static colours of an asset, and which faces are shown.

The renderer, the engines, `msb convert` and the viewers all use this rule to draw or write the opaque mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from msb.asset.activation import sigmoid
from msb.asset.sh import SH_C0

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.asset.reader import Asset

WHITE = (1.0, 1.0, 1.0)
"""The colour of a mesh that brings no colour, as in glTF."""


@dataclass(frozen=True)
class StaticColors:
    """Colours of the standard tier.

    Attributes
    ----------
    values : (n, 3) or (n, 4) uint8 or float32
        Floats are in [0, 1]; a fourth channel is not drawn.
    domain : {"vertex", "face", "corner"}
    """

    values: NDArray[Any]
    domain: Literal["vertex", "face", "corner"]


def static_colors(buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str]) -> StaticColors | None:
    """Return the colours that `buffers` bring, or clamp(C0 f_dc + 0.5, 0, 1); None if there are neither.

    Each colour is clamped before anything is interpolated (paper, "Standard deployment").

    Parameters
    ----------
    buffers : mapping of arrays
        Buffers of an asset or a model; "color" is taken before "f_dc".
    domains : mapping
        Buffer -> its domain.
    """
    for name in ("color", "f_dc"):
        if name in buffers:
            values = baked_colors(buffers[name]) if name == "f_dc" else clamped(buffers[name])
            return StaticColors(values, cast("Any", domains[name]))
    return None


def colors_of(asset: Asset) -> StaticColors | None:
    """Return the `static_colors` of an asset."""
    return static_colors(asset.buffers, {name: spec.domain for name, spec in asset.manifest.buffers.items()})


def drawn_colors(asset: Asset) -> StaticColors:
    """Return the colours `asset` is drawn in: its `static_colors`, or white."""
    white = np.full((asset.manifest.face_count, 3), WHITE, np.float32)
    return colors_of(asset) or StaticColors(white, "face")


def baked_colors(f_dc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return clamp(C0 f_dc + 0.5, 0, 1), the colour of the zeroth SH coefficient."""
    return clamped(np.float32(SH_C0) * f_dc + np.float32(0.5))


def clamped(colors: NDArray[Any]) -> NDArray[Any]:
    """Return float colours clamped to [0, 1], byte colours unchanged; NaN, which drawing refuses, stays."""
    return np.clip(colors, np.float32(0), np.float32(1)) if colors.dtype.kind == "f" else colors


def visible_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.bool_] | None:
    """Return a mask (F,) of the faces that an STE threshold leaves; None if there is no threshold or opacity.

    A face is shown if its opacity is above the threshold, both in float32, as in the official code
    (GaodeRender/triangle-splatting). The standard tier reads opacity for nothing else.
    """
    if ste_threshold is None or "opacity" not in asset.buffers:
        return None
    return np.asarray(sigmoid(asset.buffers["opacity"].reshape(-1)) > np.float32(ste_threshold))


def shown_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.uint32] | None:
    """Return the numbers of the `visible_faces`, in ascending order; None if that is all of them."""
    shown = visible_faces(asset, ste_threshold)
    return None if shown is None or shown.all() else np.flatnonzero(shown).astype(np.uint32)


def stored_threshold(asset: Asset) -> float | None:
    """Return the STE threshold that `asset` was exported with."""
    stored = asset.manifest.settings.get("ste_threshold")
    return None if stored is None else cast("float | None", stored.value)
