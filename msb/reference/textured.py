"""What textures show of a face, in NumPy, slowly and obviously right: the rules of docs/standard.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import StaticColors, corner_tint
from msb.asset.texture import ROUNDING, Textured, linear_to_srgb, mip_levels, sample

if TYPE_CHECKING:
    from msb.scenes import Camera

    Reals = NDArray[np.float64]


class Surface:
    """The textures of a mesh with faces `indices` (F, 3), times `tint` if there is one."""

    def __init__(self, textured: Textured, tint: StaticColors | None, indices: NDArray[Any]) -> None:
        self._textured = textured
        self._levels = [mip_levels(image) for image in textured.images]
        self._tint = np.ones((3 * len(indices), 4)) if tint is None else corner_tint(tint, indices)

    def at(self, face: int, order: NDArray[Any], weights: Reals, steps: Reals) -> Reals:
        """Return linear light and alpha (n, 4) of a face where its corners, in `order`, have weights (n, 3).

        `steps` (n, 2, 3) is how much the weights change to the pixel on the right and to the one below.
        """
        textured = self._textured
        number = 0 if textured.face_texture is None else int(textured.face_texture[face])
        levels = self._levels[number]
        corners = textured.uvs[face].astype(np.float64)[order]
        height, width = levels[0].shape[:2]
        texels = np.linalg.norm(steps @ corners * (width, height), axis=2).max(axis=1)
        lod = np.log2(np.maximum(texels, 1e-30))
        light = sample(levels, weights @ corners, textured.sampler, lod)
        return np.asarray(light * (weights @ self._tint[3 * face + order]))

    def is_there(self, light: Reals) -> NDArray[np.bool_]:
        """Return at which samples (n,) of `light` (n, 4) there is a surface."""
        cutoff = self._textured.sampler.alpha_cutoff
        return np.ones(len(light), bool) if cutoff is None else light[:, 3] >= cutoff - ROUNDING


def shown(light: Reals) -> Reals:
    """Return the sRGB colours (n, 3) of linear light (n, 4)."""
    return np.asarray(np.clip(linear_to_srgb(light[:, :3]), 0, 1))


def steps_at(corners: Reals, rays: Reals, camera: Camera) -> Reals:
    """Return how much (n, 2, 3) the weights of a face's corners at rays (n, 3) change to the next pixel.

    The derivatives at the sample: a weight is V / sum V, and each volume V is affine on the screen.
    """
    normals = np.cross(corners[[1, 2, 0]], corners[[2, 0, 1]])
    if corners[0] @ normals[0] < 0:
        normals = -normals
    volumes = np.maximum(rays @ normals.T, 0)
    total = volumes.sum(axis=1)[:, None, None]
    change = (normals / (camera.fx, camera.fy, 1)).T[:2]
    within = volumes[:, None] / np.where(total > 0, total, 1) * change.sum(axis=1)[:, None]
    return np.where(total > 0, (change - within) / np.where(total > 0, total, 1), 0)
