"""A VGG16 whose weights are given by a formula, so that LPIPS can be tested without the trained ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.metrics.vgg import LAYERS


def synthetic_vgg(seed: int = 1) -> dict[str, NDArray[np.float32]]:
    """Return features.N.weight and .bias: uniform numbers, weights scaled by sqrt(6 / (9 inputs))."""
    found: dict[str, NDArray[np.float32]] = {}
    for layer, (number, inputs, outputs) in enumerate(LAYERS):
        base = seed * 2**40 + layer * 2**32
        weight = _symmetric(base, outputs * inputs * 9) * np.sqrt(6 / (9 * inputs))
        found[f"features.{number}.weight"] = weight.astype(np.float32).reshape(outputs, inputs, 3, 3)
        found[f"features.{number}.bias"] = (_symmetric(base + 2**31, outputs) * 0.05).astype(np.float32)
    return found


def _symmetric(base: int, count: int) -> NDArray[np.float64]:
    """Return `count` numbers in [-1, 1): the 53 upper bits of SplitMix64's output for base, base + 1, ..."""
    z: Any = np.uint64(base) + np.arange(count, dtype=np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return 2 * ((z >> np.uint64(11)).astype(np.float64) / 2**53) - 1
