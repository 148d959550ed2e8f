"""Undistortion of photographs: the undistorted pinhole camera, and the resampled image."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb.errors import SceneError
from msb.scenes.camera import Camera

if TYPE_CHECKING:
    from msb.scenes.distortion import Distortion

# A grid of points tests whether content is missing in an undistorted image. Grids of 33 and of 129 points per
# side gave the same sizes for all tested lenses, because lens distortion varies slowly.
_GRID = 65
# Smallest and largest ratio of the undistorted side to the distorted side. COLMAP has the same limits for
# this ratio.
_MIN_SCALE, _MAX_SCALE = 0.2, 2.0
# Number of bisections of a scale. At the largest image size, an error of 2 / 2^24 is less than a thousandth
# of a pixel.
_STEPS = 24


def undistorted(camera: Camera) -> Camera:
    """Return the pinhole camera of the undistorted photographs of `camera`.

    Pose and focal lengths are kept. Width, height and principal point are scaled separately for each axis.
    The result is the largest image whose pixels all lie inside the distorted image, as in COLMAP's
    undistorter. A camera without distortion is returned unchanged.

    Raises
    ------
    SceneError
        CAMERA_DISTORTED: the coefficients fold the image over itself, so no undistorted image exists.
    """
    if camera.distortion is None:
        return camera
    key = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    width, height = _fit_size(*key, camera.distortion)
    return replace(
        camera,
        width=width,
        height=height,
        cx=camera.cx * width / camera.width,
        cy=camera.cy * height / camera.height,
        distortion=None,
    )


@lru_cache(maxsize=256)
def _fit_size(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, distortion: Distortion
) -> tuple[int, int]:
    """Return the width and height of the largest undistorted image in which no content is missing."""

    def fits(scale_x: float, scale_y: float) -> bool:
        # Create a grid (n, n) from edge to edge of the undistorted image, and map it to the distorted image.
        # The mapped grid must lie between the centres of the outermost pixels. Pixel values outside these
        # centres cannot be interpolated.
        u, v = np.meshgrid(
            np.linspace(-cx * scale_x, (width - cx) * scale_x, _GRID),
            np.linspace(-cy * scale_y, (height - cy) * scale_y, _GRID),
        )
        x, y = distortion.apply(u / fx, v / fy)
        x, y = x * fx + cx, y * fy + cy
        is_inside = (x >= 0.5) & (x <= width - 0.5) & (y >= 0.5) & (y <= height - 0.5)
        # Each grid cell must have a positive area, otherwise the image is folded over.
        right, down = (
            (np.diff(x, axis=1)[:-1], np.diff(y, axis=1)[:-1]),
            (np.diff(x, axis=0), np.diff(y, axis=0)),
        )
        area = right[0] * down[1][:, :-1] - right[1] * down[0][:, :-1]
        return bool(is_inside.all() and (area > 0).all())

    # First enlarge both axes by the same factor. Then enlarge each axis separately.
    scale_x = scale_y = _largest(lambda scale: fits(scale, scale), _MIN_SCALE)
    scale_x = _largest(lambda scale: fits(scale, scale_y), scale_x)
    scale_y = _largest(lambda scale: fits(scale_x, scale), scale_y)
    if not fits(scale_x, scale_y):
        text = (
            f"the lens model {distortion.model} with {', '.join(f'{c:g}' for c in distortion.coefficients)} "
            f"folds the image over itself at {width} x {height} pixels; calibrate the camera again"
        )
        raise SceneError("CAMERA_DISTORTED", text)
    return max(1, int(width * scale_x + 1e-6)), max(1, int(height * scale_y + 1e-6))


def _largest(is_valid: Any, low: float) -> float:
    """By bisection, find and return the largest valid scale between `low` and `_MAX_SCALE`."""
    high = _MAX_SCALE
    if is_valid(high):
        return high
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_valid(middle) else (low, middle)
    return low


def undistort_image(pixels: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """Resample the photograph (H, W, C) of `camera` to the image (H', W', C) of `undistorted(camera)`.

    OpenCV interpolates the values linearly. The photograph must have the size of `camera`. Raise
    EXTRA_MISSING if OpenCV is not installed.
    """
    if camera.distortion is None:
        return pixels
    need_extra("bench", "cv2", what="the undistortion of photographs")
    import cv2

    key = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    target = undistorted(camera)
    x, y = _source_pixels(*key, camera.distortion, target.width, target.height, target.cx, target.cy)
    image = cv2.remap(pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(image, np.uint8).reshape(target.height, target.width, *pixels.shape[2:])


@lru_cache(maxsize=2)
def _source_pixels(
    width: int,
    height: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    distortion: Distortion,
    new_width: int,
    new_height: int,
    new_cx: float,
    new_cy: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the x and y coordinates (H', W') in the distorted image for each undistorted pixel.

    The centre of the first pixel is (0, 0), as in OpenCV.
    """
    u, v = np.meshgrid(np.arange(new_width) + 0.5 - new_cx, np.arange(new_height) + 0.5 - new_cy)
    x, y = distortion.apply(u / fx, v / fy)
    return (x * fx + cx - 0.5).astype(np.float32), (y * fy + cy - 0.5).astype(np.float32)
