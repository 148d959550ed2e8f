"""Supersampling, the option of the standard tier: many samples a pixel."""

from __future__ import annotations

import operator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError

if TYPE_CHECKING:
    from msb.render.frame import Frame
    from msb.scenes import Camera

MAX_SUPERSAMPLE = 16


def checked_supersample(value: int) -> int:
    """Return the samples along each side of a pixel, if there can be so many."""
    try:
        samples = 0 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        samples = 0
    if not 1 <= samples <= MAX_SUPERSAMPLE:
        text = f"supersample is {value!r:.40}; it must be a whole number from 1 to {MAX_SUPERSAMPLE}"
        raise UsageError("SETTING_VALUE", text)
    return samples


def enlarged(camera: Camera, scale: int) -> Camera:
    """Return `camera` with `scale` times as many pixels each way."""
    return camera if scale == 1 else camera.resized(camera.width * scale, camera.height * scale)


def box_filter(frame: Frame, scale: int) -> Frame:
    """Return `frame` with `scale` x `scale` of its pixels made one.

    Image and alpha are means. Depth and face are those of the nearest sample; at equal depths the lowest face
    number counts.
    """
    image, alpha = box_mean(frame.image, scale), box_mean(frame.alpha, scale)
    depth = _blocks(frame.depth, scale)
    distance = np.where(depth > 0, depth, np.float32(np.inf))
    nearest = distance.min(axis=-1)
    if frame.face_id is not None:
        faces = _blocks(frame.face_id, scale)
        at_nearest = (distance == nearest[..., None]) & (faces >= 0)
        lowest = np.where(at_nearest, faces, np.iinfo(np.int32).max).min(axis=-1)
        faces = np.where(np.isfinite(nearest), lowest, -1).astype(np.int32)
        frame = replace(frame, face_id=faces)
    return replace(
        frame, image=image, alpha=alpha, depth=np.where(np.isfinite(nearest), nearest, np.float32(0))
    )


def box_mean(plane: NDArray[np.float32], scale: int) -> NDArray[np.float32]:
    """Return a plane (H s, W s, ...) whose pixels are the means of `scale` x `scale` of its own."""
    bands = plane.reshape(-1, scale, *plane.shape[1:])  # one at a time, which the processor's cache holds
    means = [_blocks(band, scale).mean(axis=-1, dtype=np.float32) for band in bands]
    return np.asarray(np.concatenate(means), np.float32)


def _blocks(array: NDArray[Any], scale: int) -> NDArray[Any]:
    """Return an (H s, W s, ...) array as (H, W, ..., s s)."""
    height, width, *rest = array.shape
    parts = array.reshape(height // scale, scale, width // scale, scale, *rest)
    order = (0, 2, *range(4, parts.ndim), 1, 3)
    moved = parts.transpose(order)
    return moved.reshape(*moved.shape[:-2], scale * scale)
