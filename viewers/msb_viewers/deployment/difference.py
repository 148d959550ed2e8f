"""The difference of two images: a colour for each pixel, and a PSNR in dB."""

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A colour scale from no difference to the largest difference. The colours are evenly spaced on the scale and
# interpolated linearly. The colours agree with the scale magma of matplotlib (van der Walt and Smith, 2015)
# to 3 / 255. The colour scale is perceptually uniform and ordered by lightness, so colour-blind readers can
# use it.
ERROR_SCALE = (
    (0, 0, 4), (10, 8, 34), (29, 17, 70), (54, 16, 106), (80, 18, 124), (105, 28, 129), (130, 38, 129),
    (156, 46, 127), (182, 55, 121), (207, 65, 112), (230, 81, 99), (245, 105, 92), (251, 135, 97),
    (254, 165, 113), (254, 195, 135), (253, 224, 162), (252, 253, 191),
)  # fmt: skip
# The values that users can choose for the smallest difference with the brightest colour, in [0, 1].
TOPS = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02)
# The page starts with this limit for the brightest colour. A composed image always uses this limit for the
# brightest colour.
TOP = 0.25


def squared_error(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the squared difference of each pixel (H, W), averaged over channels, in [0, 1].

    The mean of the squared differences over all pixels is the mean squared error of the PSNR.
    """
    away = a.astype(np.float32) - b.astype(np.float32)
    return np.asarray(np.einsum("hwc,hwc->hw", away, away) / np.float32(3 * 255**2))


def colorize(squared: NDArray[np.float32], top: float) -> NDArray[np.uint8]:
    """Return colours (H, W, 3) for squared differences (H, W).

    Differences of at least `top` get the brightest colour.
    """
    place = np.sqrt(squared) * np.float32(255 / top)
    return scale_colors()[np.minimum(place, 255).astype(np.uint8)]


@cache
def scale_colors() -> NDArray[np.uint8]:
    """Return the colour scale as 256 colours (256, 3)."""
    at = np.linspace(0, 255, len(ERROR_SCALE))
    channels = [np.interp(np.arange(256), at, channel) for channel in zip(*ERROR_SCALE, strict=True)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


def decibel_text(value: float) -> str:
    """Return a PSNR as text.

    >>> decibel_text(31.26), decibel_text(math.inf)
    ('31.26 dB', 'identical')
    """
    return "identical" if math.isinf(value) else f"{value:.2f} dB"


def resize(image: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    """Resize an image or an array of squared differences."""
    from PIL import Image

    if image.shape[:2] == (height, width):
        return image
    # If the image becomes smaller, average pixels. If it becomes larger, repeat pixels.
    smaller = width < image.shape[1] or height < image.shape[0]
    filtering = Image.Resampling.BOX if smaller else Image.Resampling.NEAREST
    return np.asarray(Image.fromarray(image).resize((width, height), filtering))
