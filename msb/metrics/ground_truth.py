"""Prepare a photograph for comparison with a rendering: rotate, undistort, mask, resize and round it."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import MetricError
from msb.metrics.image_files import read_mask, read_pixels
from msb.scenes import Camera
from msb.scenes.datasets import DATASETS, Scene
from msb.scenes.datasets.photographs import PHOTOGRAPH_MODES
from msb.scenes.datasets.scene import Reading
from msb.scenes.lenses import undistort_image


def ground_truth(scene: Scene, camera: Camera) -> NDArray[np.float32]:
    """Return the photograph of `camera`, prepared for comparison with a rendering.

    The photograph is rotated and undistorted first (`read_photograph`).

    Parameters
    ----------
    scene : Scene
        The scene, which defines how photographs are masked, resized and rounded.
    camera : Camera
        A camera of the scene.

    Returns
    -------
    image : (H, W, 3) float32
        RGB in [0, 1] at the size of the camera. Our rules round floats to 8 bits by floor(255 x + 0.5), so
        that values are multiples of 1 / 255.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        CAMERA_DISTORTED: the lens cannot be undistorted.
    MetricError
        METRIC_IMAGE: a file is damaged or has an unsupported format. METRIC_SIZES_DIFFER: mask and photograph
        differ in size.

    Notes
    -----
    Photographs without a mask are resized as 8-bit images, bit for bit like the 3DGS family
    (`graphdeco-inria/gaussian-splatting`: utils/general_utils.py, PILtoTorch). "before_resize": the mask is
    applied to floats at the stored size, and the result is resized. "after_resize": colours and mask are
    resized separately as 8-bit images. The result is rgb a + background (1 - a), where a is the mask.
    """
    if camera.image_path is None:
        raise ValueError("the camera has no image_path; use a camera of a scene")
    size = camera.width, camera.height
    pixels = read_photograph(scene, camera)
    color, alpha = pixels[..., :3], pixels[..., 3:]
    if scene.mask_source in ("mask_folder", "mask_path"):
        alpha = read_photograph_mask(scene, camera, color.shape[:2])
    elif scene.mask_source is None:
        alpha = alpha[..., :0]
    if alpha.shape[2] == 0:
        image = _resize(color, size, scene.resampling) / 255.0
    elif scene.compositing == "after_resize":
        color, alpha = (_resize(part, size, scene.resampling) for part in (color, alpha))
        image = _composite(color, alpha, scene.background)
    else:
        image = _resize(_composite(color, alpha, scene.background), size, scene.resampling)
    image = np.clip(image, 0, 1)
    if scene.quantized:
        image = np.floor(image * 255 + 0.5) / 255
    return image.astype(np.float32)


def read_photograph(scene: Scene, camera: Camera) -> NDArray[np.uint8]:
    """Return the photograph of a view, rotated and undistorted, before masking and resizing.

    The result is (H, W, 3), or (H, W, 4) with alpha. The EXIF orientation is applied if the scene requires
    this, grey becomes R = G = B, and lens distortion is removed. Raises like `ground_truth`.
    """
    assert camera.image_path is not None
    pixels = read_pixels(camera.image_path, PHOTOGRAPH_MODES)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.shape[2] < 3:  # convert a grey image to colour
        pixels = np.concatenate([pixels[..., :1].repeat(3, axis=2), pixels[..., 1:]], axis=2)
    reading = scene.readings.get(str(camera.name), Reading())
    return _apply_reading(pixels, reading)


def _apply_reading(pixels: NDArray[np.uint8], reading: Reading) -> NDArray[np.uint8]:
    """Return an image (H, W, C) after rotation and undistortion."""
    if reading.orientation != 1:
        pixels = np.ascontiguousarray(_TURNS[reading.orientation](pixels))
    return pixels if reading.lens is None else undistort_image(pixels, reading.lens)


# For each EXIF orientation, the function that rotates an image upright (EXIF 2.3: Orientation). Orientations
# that do not swap the axes are never applied.
_TURNS: dict[int, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
    5: lambda image: image.swapaxes(0, 1),
    6: lambda image: np.rot90(image, -1),
    7: lambda image: np.rot90(image.swapaxes(0, 1), 2),
    8: np.rot90,
}


def read_photograph_mask(scene: Scene, camera: Camera, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the mask (H, W, 1) of a view, rotated and undistorted like its photograph of (H, W) = `shape`.

    The mask is the first channel of the file. A view without a mask is treated as opaque. In captures outside
    the benchmark, a mask of another size is resized.
    """
    path = scene.masks.get(str(camera.name))
    if path is None:
        return np.full((*shape, 1), 255, np.uint8)
    mask, reading = read_mask(path)[..., None], scene.readings.get(str(camera.name), Reading())
    lens = reading.lens
    height, width = shape if lens is None else (lens.height, lens.width)
    # A mask with the shape of the rotated photograph is already upright. All other masks are rotated.
    if reading.orientation != 1 and (mask.shape[0] > mask.shape[1]) != (height > width):
        mask = _apply_reading(mask, Reading(reading.orientation))
    if mask.shape[:2] != (height, width):
        if scene.dataset in DATASETS:
            text = f"it has {mask.shape[1]} x {mask.shape[0]} pixels; its photograph has {width} x {height}"
            raise MetricError("METRIC_SIZES_DIFFER", text, file=path)
        mask = _resize(mask, (width, height), "bilinear")
    return _apply_reading(mask, Reading(lens=lens))


def _composite(color: NDArray[np.uint8], alpha: NDArray[np.uint8], background: Any) -> NDArray[np.float64]:
    weight = alpha / 255.0
    return np.asarray(color / 255.0 * weight + np.asarray(background, np.float64) * (1 - weight))


def _resize(image: NDArray[Any], size: tuple[int, int], resampling: str) -> NDArray[Any]:
    """Return the image, resized by Pillow to `size`.

    The result is uint8 for a uint8 image, otherwise float32.
    """
    from PIL import Image

    if (image.shape[1], image.shape[0]) == size:
        return image
    method = {"bicubic": Image.Resampling.BICUBIC, "bilinear": Image.Resampling.BILINEAR}[resampling]
    kind = np.uint8 if image.dtype == np.uint8 else np.float32
    planes = (Image.fromarray(np.ascontiguousarray(plane, kind)) for plane in np.moveaxis(image, 2, 0))
    return np.stack([np.asarray(plane.resize(size, method)) for plane in planes], axis=-1)
