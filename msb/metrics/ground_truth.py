"""Prepare a photograph for comparison with a rendering: mask, resize and round it."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import MetricError
from msb.metrics.image_files import read_mask, read_pixels
from msb.scenes import Camera
from msb.scenes.datasets import Scene
from msb.scenes.datasets.photographs import find_mask


def ground_truth(scene: Scene, camera: Camera) -> NDArray[np.float32]:
    """Return the photograph of `camera`, prepared for comparison with a rendering.

    Parameters
    ----------
    scene : Scene
        The scene, which defines how photographs are masked, resized and rounded.
    camera : Camera
        A camera of the scene.

    Returns
    -------
    image : (H, W, 3) float32
        RGB in [0, 1] at the size of the camera. If the rules round to 8 bits by floor(255 x + 0.5), as ours
        do, values are multiples of 1 / 255.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        SCENE_IMAGE: the photograph of a training view has no mask of its size.
    MetricError
        METRIC_IMAGE: a file is damaged or of another kind. METRIC_SIZES_DIFFER: mask and photograph differ in
        size.

    Notes
    -----
    Photographs without a mask are resized as 8-bit images, bit for bit like the 3DGS family
    (`graphdeco-inria/gaussian-splatting`: utils/general_utils.py, PILtoTorch). "before_resize": the mask is
    applied at the stored size, in floats, and floats are resized. "after_resize": colours and mask are
    resized separately as 8-bit images, then I = rgb a + background (1 - a).
    """
    if camera.image_path is None:
        raise ValueError("the camera has no image_path; use a camera of a scene")
    size = camera.width, camera.height
    pixels = read_pixels(camera.image_path)
    color, alpha = pixels[..., :3], pixels[..., 3:]
    if scene.mask_source == "mask_folder":
        alpha = _read_mask(scene, camera, color.shape)
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


def find_mask_file(scene: Scene, camera: Camera) -> Path:
    """Return the mask file of a camera in a scene with a mask folder."""
    assert camera.image_path is not None
    # `scene.masks` only has the masks of test views, because a run evaluates only these.
    return scene.masks.get(str(camera.name)) or find_mask(scene.root, camera.image_path)


def _read_mask(scene: Scene, camera: Camera, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the mask (H, W, 1) of a camera: the first channel of its mask file, as in culling."""
    path = find_mask_file(scene, camera)
    mask = read_mask(path)
    if mask.shape != shape[:2]:
        text = f"it has {mask.shape[1]} x {mask.shape[0]} pixels, its photograph {shape[1]} x {shape[0]}"
        raise MetricError("METRIC_SIZES_DIFFER", text, file=path)
    return mask[..., None]


def _composite(color: NDArray[np.uint8], alpha: NDArray[np.uint8], background: Any) -> NDArray[np.float64]:
    weight = alpha / 255.0
    return np.asarray(color / 255.0 * weight + np.asarray(background, np.float64) * (1 - weight))


def _resize(image: NDArray[Any], size: tuple[int, int], resampling: str) -> NDArray[Any]:
    """Return the image, resized by Pillow to `size`. Bytes stay bytes, and floats become float32."""
    from PIL import Image

    if (image.shape[1], image.shape[0]) == size:
        return image
    method = {"bicubic": Image.Resampling.BICUBIC, "bilinear": Image.Resampling.BILINEAR}[resampling]
    kind = np.uint8 if image.dtype == np.uint8 else np.float32
    planes = (Image.fromarray(np.ascontiguousarray(plane, kind)) for plane in np.moveaxis(image, 2, 0))
    return np.stack([np.asarray(plane.resize(size, method)) for plane in planes], axis=-1)
