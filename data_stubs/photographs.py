"""Photographs of a surface: renderings of our standard tier with many samples per pixel, averaged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.render import render

if TYPE_CHECKING:
    from data_stubs.still_life import LitSurface
    from msb.scenes import Camera

SAMPLES = 4
"""Number of samples along each side of a pixel."""


def photograph(surface: LitSurface, camera: Camera) -> NDArray[np.float64]:
    """Return what `camera` sees, (H, W, 4) in [0, 1]: straight colour, and the share of covered samples."""
    colors = to_bytes(surface.seen_from(camera.center))
    asset = asset_from_mesh(Mesh(surface.vertices, surface.faces, colors, None))
    fine = render(asset, camera.resized(SAMPLES * camera.width, SAMPLES * camera.height))
    alpha = averaged(fine.alpha.astype(np.float64)[..., None], SAMPLES)
    color = averaged(fine.image.astype(np.float64), SAMPLES)  # over black: times alpha
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
