"""Photographs of a surface: the float64 twin of the standard tier, sampled finely and averaged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from msb.reference.standard import render_standard

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from data_stubs.surface import Surface
    from msb.scenes import Camera

SAMPLES = 4
"""Number of samples along each side of a pixel."""


def photograph(surface: Surface, camera: Camera) -> NDArray[np.float64]:
    """Return what `camera` sees, (H, W, 4) in [0, 1]: straight colour, and the share of covered samples."""
    fine = camera.resized(SAMPLES * camera.width, SAMPLES * camera.height)
    frame = render_standard(
        surface.vertices, surface.faces, surface.seen_from(camera.center), "vertex", replace(fine, name=None)
    )
    alpha = averaged(np.asarray(frame.alpha)[..., None], SAMPLES)
    color = averaged(np.asarray(frame.image), SAMPLES)  # over black: times alpha
    straight = np.divide(color, alpha, out=np.zeros_like(color), where=alpha > 0)
    return np.concatenate([straight, alpha], axis=2)


def averaged(image: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Return the means of blocks of `factor` x `factor` pixels of an image (H, W, C)."""
    height, width, channels = image.shape
    blocks = image.reshape(height // factor, factor, width // factor, factor, channels)
    return np.asarray(blocks.mean(axis=(1, 3)))


def to_bytes(image: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return floor(255 x + 0.5)."""
    return np.floor(np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
