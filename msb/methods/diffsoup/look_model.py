"""Check that an asset has what the lattice renderer needs, and prepare the arrays that go to the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.drawable import check_drawable, require, required_buffer
from msb.errors import AssetError

if TYPE_CHECKING:
    from msb.asset import Asset

FEATURES = 7
LAYERS = {"mlp.0": (16, 16), "mlp.2": (16, 16), "mlp.4": (3, 16)}
"""Layer of the decoder -> shape of its weight, [out, in]."""
THRESHOLD = 0.5
MAX_LEVEL = 8
"""The highest level of a lattice, which has 33,153 samples at level 8."""
_MARGIN = 1e-5
"""A margin greater than the rounding of interpolation at values up to 2."""


@dataclass(frozen=True)
class DiffSoupModel:
    """A DiffSoup model whose values can all be drawn.

    Attributes
    ----------
    positions : (V, 3) float32
    indices : (F, 3) uint32
    features : (F, S, 7) float32 or uint8
        Bytes stand for value / 255.
    opacity : (F, S), of the same dtype
    opaque : (F,) uint8
        1 for faces in which no interpolated opacity can be below the threshold.
    decoder : (595,) float32
        The weight [out][in] and the bias of each layer, one after the other.
    level : int
        The level of the lattices, which have S = (2^level + 1)(2^level + 2) / 2 samples.
    """

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    features: NDArray[Any]
    opacity: NDArray[Any]
    opaque: NDArray[np.uint8]
    decoder: NDArray[np.float32]
    level: int


def diffsoup_model(asset: Asset, *, quantise: bool = False) -> DiffSoupModel:
    """Return the model `asset` holds; nothing is copied but the decoder.

    Parameters
    ----------
    asset : Asset
        An asset whose manifest has the `compositing.kind` "binary_z_buffer".
    quantise : bool
        Whether lattices of numbers are made bytes, as the official web export does: trunc(clip(255 x, 0,
        255)), the product in float32 (kenji-tojo/diffsoup: examples/06_export_web.py).
    """
    require(asset, "compositing", "kind", "binary_z_buffer")
    level = asset.manifest.appearance.get("level")
    if type(level) is not int or not 0 <= level <= MAX_LEVEL:
        text = f"appearance.level is {level!r:.40}; it must be an integer from 0 to {MAX_LEVEL}"
        raise AssetError("TRIASSET_FIELD", text, file=asset.path, pointer="/appearance/level")
    check_drawable(asset)
    faces, samples = asset.manifest.face_count, (2**level + 1) * (2**level + 2) // 2
    positions = required_buffer(asset, "positions", asset.manifest.vertex_count, 3)
    indices = required_buffer(asset, "indices", faces, 3)
    features = required_buffer(asset, "features.lattice", faces, samples, FEATURES)
    opacity = required_buffer(asset, "features.opacity", faces, samples)
    if features.dtype != opacity.dtype:
        text = f"features.lattice is {features.dtype}, but features.opacity {opacity.dtype}; both must be one"
        raise AssetError("TRIASSET_BUFFER", text, file=asset.path, pointer="/buffers/features.opacity")
    if quantise:
        features, opacity = _as_bytes(features), _as_bytes(opacity)
    net = []
    for layer, shape in LAYERS.items():
        net += [
            required_buffer(asset, f"decoder.{layer}.weight", *shape),
            required_buffer(asset, f"decoder.{layer}.bias", shape[0]),
        ]
    decoder = np.concatenate([array.reshape(-1) for array in net], dtype=np.float32)
    return DiffSoupModel(positions, indices, features, opacity, _always_opaque(opacity), decoder, level)


def _as_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    if values.dtype == np.uint8:
        return values
    return np.asarray(np.clip(values * np.float32(255), 0, 255), np.uint8)


def _always_opaque(opacity: NDArray[Any]) -> NDArray[np.uint8]:
    scale = 255 if opacity.dtype == np.uint8 else 1
    low, high = opacity.min(axis=1), opacity.max(axis=1)
    return np.asarray((low >= (THRESHOLD + _MARGIN) * scale) & (high <= 2 * scale), np.uint8)
