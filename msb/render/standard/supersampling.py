"""Supersampling, the option of the standard tier: many samples a pixel."""

import operator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError
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
    # Depths are positive, so their bits are in order; faces as unsigned numbers put those of no face last.
    samples = np.where(frame.depth > 0, frame.depth, np.inf).astype(np.float32).view(np.uint32)
    if frame.face_id is not None:
        samples = samples.astype(np.uint64) << np.uint64(32) | frame.face_id.astype(np.uint32)
    nearest = _boxes(samples, scale, np.minimum)
    if frame.face_id is not None:
        frame = replace(frame, face_id=nearest.astype(np.uint32).view(np.int32))
        nearest = (nearest >> np.uint64(32)).astype(np.uint32)
    depth = nearest.view(np.float32)
    depth[np.isinf(depth)] = 0
    return replace(frame, image=image, alpha=alpha, depth=depth)


def box_mean(plane: NDArray[np.float32], scale: int) -> NDArray[np.float32]:
    """Return a plane (H s, W s, ...) whose pixels are the means of `scale` x `scale` of its own."""
    return np.asarray(_boxes(plane, scale, np.add) / scale**2, np.float32)


def _boxes(plane: NDArray[Any], scale: int, both: np.ufunc) -> NDArray[Any]:
    """Return a plane (H s, W s, ...) whose pixels are `scale` x `scale` of its own put together by `both`."""
    height, width, *rest = plane.shape
    rows = plane.reshape(height // scale, scale, -1)
    columns = _together(rows.swapaxes(0, 1), both).reshape(height // scale, width // scale, scale, *rest)
    return _together(np.moveaxis(columns, 2, 0), both)


def _together(parts: NDArray[Any], both: np.ufunc) -> NDArray[Any]:
    """Return what `both` makes of all parts: pass by pass, which is many times as fast as `reduce` here."""
    made: NDArray[Any] = parts[0].copy()
    for part in parts[1:]:
        both(made, part, out=made)
    return made
