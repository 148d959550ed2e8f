"""Supersampling, an option of the standard tier: several samples per pixel."""

import operator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError
from msb.render.frame import Frame
from msb.scenes import Camera

MAX_SUPERSAMPLE = 16


def check_supersample(value: int) -> int:
    """Return `value`, the number of samples along each side of a pixel; raise SETTING_VALUE if it is
    invalid."""
    try:
        samples = 0 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        samples = 0
    if not 1 <= samples <= MAX_SUPERSAMPLE:
        text = f"supersample is {value!r:.40}; it must be a whole number from 1 to {MAX_SUPERSAMPLE}"
        raise UsageError("SETTING_VALUE", text)
    return samples


def enlarge(camera: Camera, scale: int) -> Camera:
    """Return `camera` with `scale` times as many pixels along each axis."""
    return camera if scale == 1 else camera.resized(camera.width * scale, camera.height * scale)


def box_filter(frame: Frame, scale: int) -> Frame:
    """Return a frame whose pixels each combine `scale` x `scale` pixels of `frame`.

    Image and alpha are means over the samples. Depth and face are taken from the nearest sample. If samples
    have equal depths, the lowest face number wins.
    """
    image, alpha = box_mean(frame.image, scale), box_mean(frame.alpha, scale)
    # The bits of positive floats sort in the order of the floats. As an unsigned number, the face -1 of the
    # background is the largest, so background samples come last. The smallest 64-bit key of (depth, face)
    # belongs to the nearest sample with the lowest face.
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
    """Return a plane whose pixels are means of `scale` x `scale` pixels of `plane` (H s, W s, ...)."""
    return np.asarray(_boxes(plane, scale, np.add) / scale**2, np.float32)


def _boxes(plane: NDArray[Any], scale: int, combine: np.ufunc) -> NDArray[Any]:
    """Return a plane whose pixels each combine `scale` x `scale` pixels of `plane` (H s, W s, ...)."""
    height, width, *rest = plane.shape
    rows = plane.reshape(height // scale, scale, -1)
    columns = _reduce(rows.swapaxes(0, 1), combine).reshape(height // scale, width // scale, scale, *rest)
    return _reduce(np.moveaxis(columns, 2, 0), combine)


def _reduce(parts: NDArray[Any], combine: np.ufunc) -> NDArray[Any]:
    """Combine all parts one after another. A loop over the parts is faster than `ufunc.reduce`."""
    total: NDArray[Any] = parts[0].copy()
    for part in parts[1:]:
        combine(total, part, out=total)
    return total
