"""PSNR and SSIM of two images, and the input checks of all image metrics."""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.base.extras import need_extra
from msb.errors import MetricError
from msb.metrics.identity import ImageMetric

# Value in dB that replaces an infinite PSNR in averages. The number of images with infinite PSNR is also
# reported.
PSNR_CAP = 100.0
# Radius of the 11 x 11 window in pixels.
_WINDOW_RADIUS = 5


def find_max_psnr(pixels: int) -> float:
    """Return the largest PSNR in dB that two different 8-bit images with this number of pixels can have."""
    # Pixel values are bytes / 255. The smallest difference is 1/255 in a single channel of one pixel.
    return 10 * math.log10(255**2 * 3 * pixels)


def psnr(pred: ArrayLike, gt: ArrayLike, *, quantize: bool = True) -> float:
    """Return the peak signal-to-noise ratio in dB: 10 log10(1 / mse).

    Parameters
    ----------
    pred, gt : (H, W, 3) uint8 or float
        RGB images of equal size. Floats are clamped to [0, 1]; bytes are divided by 255.
    quantize : bool
        Whether floats are first rounded to 8 bits by floor(255 x + 0.5). Files behind published numbers are
        rounded in this way. The benchmark rounds images to 8 bits.

    Returns
    -------
    float
        The PSNR in dB; inf for equal images. The mean squared error is computed over all pixels and channels,
        in float64.

    Raises
    ------
    MetricError
        METRIC_IMAGE or METRIC_SIZES_DIFFER.

    Notes
    -----
    The training log of the 3DGS family has a different quantity: the average of three PSNRs, one per channel
    (`graphdeco-inria/gaussian-splatting`: utils/image_utils.py, called with channels first).

    Examples
    --------
    >>> import numpy as np
    >>> black, grey = np.zeros((8, 8, 3)), np.full((8, 8, 3), 0.2)
    >>> round(psnr(grey, black), 6)
    13.9794
    """
    return _psnr(*check_pair(pred, gt, quantize=quantize))


def psnr_of_mse(mse: float) -> float:
    """Return the PSNR in dB of a mean squared error of values in [0, 1]; inf if the error is 0.

    If the images are bytes, divide the mean squared error by 255^2 before the call. Callers decide how to
    print or average an infinite PSNR: as `PSNR_CAP`, as None or as "equal".
    """
    return math.inf if mse == 0 else -10 * math.log10(mse)


def _psnr(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return psnr_of_mse(float(np.mean(np.square(a - b))))


def ssim(pred: ArrayLike, gt: ArrayLike, *, quantize: bool = True) -> float:
    """Return the structural similarity (SSIM) as evaluated by the 3DGS family, in float64.

    The window is an 11 x 11 Gaussian with sigma 1.5 pixels. The image is padded with zeros, so every pixel
    counts. Variances are population variances, C1 = 0.01^2, C2 = 0.03^2, and the result is the average over
    all pixels and channels.

    Parameters
    ----------
    pred, gt : (H, W, 3) uint8 or float
        Images as for `psnr`, of at least one pixel.
    quantize : bool
        As for `psnr`.

    Returns
    -------
    float
        The SSIM in [-1, 1]; 1 for equal images.

    Raises
    ------
    UsageError
        EXTRA_MISSING: scikit-image is not installed.
    MetricError
        METRIC_IMAGE or METRIC_SIZES_DIFFER.

    Notes
    -----
    Definition: Wang et al., Image Quality Assessment: From Error Visibility to Structural Similarity, 2004.
    Border rule: `graphdeco-inria/gaussian-splatting`: utils/loss_utils.py.
    """
    return _ssim(*check_pair(pred, gt, quantize=quantize))


def _ssim(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    need_extra("bench", "skimage", what="SSIM")
    with ThreadPoolExecutor(3) as pool:  # the filters release the GIL
        channels = list(pool.map(_ssim_channel, np.moveaxis(a, 2, 0), np.moveaxis(b, 2, 0)))
    return math.fsum(channels) / len(channels)


def _ssim_channel(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the average SSIM of one channel (H, W).

    scikit-image averages only over windows that lie completely inside the image. The image is therefore
    padded with zeros by the radius of the window. After padding, there is a window around every pixel of the
    image.
    """
    from skimage.metrics import structural_similarity

    measure: Any = structural_similarity  # untyped
    value = measure(
        np.pad(a, _WINDOW_RADIUS),
        np.pad(b, _WINDOW_RADIUS),
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(value)


def is_plain(image: NDArray[Any]) -> bool:
    """Return whether all pixels of an image (H, W, 3) have the same colour, as in an empty rendering."""
    return bool((image == image[:1, :1]).all())


def check_pair(
    pred: ArrayLike, gt: ArrayLike, *, quantize: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both images as (H, W, 3) float64 in [0, 1], checked and rounded by the input rule."""
    a, b = check_image(pred, "pred"), check_image(gt, "gt")
    if a.shape != b.shape:
        sizes = [f"{image.shape[1]} x {image.shape[0]}" for image in (a, b)]
        text = f"pred has {sizes[0]} pixels and gt {sizes[1]}; sizes must be equal"
        raise MetricError("METRIC_SIZES_DIFFER", text)
    return _to_unit_range(a, quantize), _to_unit_range(b, quantize)


def check_image(image: ArrayLike, name: str) -> NDArray[Any]:
    """Return an image that metrics accept. If the image called `name` is invalid, raise METRIC_IMAGE."""
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        shape = " x ".join(map(str, array.shape)) or "a single value"
        text = f"{name} has shape {shape}; it must be height x width x 3"
        raise MetricError("METRIC_IMAGE", text)
    if array.dtype == np.uint8:
        return array
    if array.dtype.kind != "f":
        text = f"{name} has dtype {array.dtype}; it must be uint8, or floating point in [0, 1]"
        raise MetricError("METRIC_IMAGE", text)
    finite = np.isfinite(array)
    if not finite.all():
        y, x, channel = (int(i) for i in np.argwhere(~finite)[0])
        text = f"{name}[{y}, {x}, {channel}] is {array[y, x, channel]}; every value must be a finite number"
        raise MetricError("METRIC_IMAGE", text, pointer=f"{name}[{y}, {x}, {channel}]")
    # A few values above 1 may come from the renderer and are clamped. If most values are above 2, they are
    # probably bytes that were not divided by 255.
    if 2 * np.count_nonzero(array > 2) > array.size:
        text = f"most values of {name} are above 2, the largest is {array.max():g}; floats must be in [0, 1]"
        raise MetricError("METRIC_IMAGE", text)
    return array


def _to_unit_range(array: NDArray[Any], quantize: bool) -> NDArray[np.float64]:
    """Return an image as values in [0, 1].

    If `quantize` is true, floats are first rounded to multiples of 1 / 255.
    """
    if array.dtype != np.uint8:
        kind = array.dtype if array.dtype.itemsize >= 4 else np.dtype(np.float32)
        clamped = np.clip(array.astype(kind), 0, 1)
        if not quantize:
            return clamped.astype(np.float64)
        array = np.floor(clamped * kind.type(255) + kind.type(0.5))
    return array.astype(np.float64) / 255


PSNR = ImageMetric(
    name="psnr",
    key="psnr",
    title="PSNR",
    unit="dB",
    decimals=2,
    better="higher",
    equal=math.inf,
    measure=_psnr,
    parameters={"peak": 1.0, "mse": "all pixels and channels"},
    libraries=("numpy",),
)
SSIM = ImageMetric(
    name="ssim",
    key="ssim",
    title="SSIM",
    unit="1",
    decimals=3,
    better="higher",
    equal=1.0,
    measure=_ssim,
    modules=("skimage",),
    parameters={
        "window": "gaussian 11 x 11, sigma 1.5",
        "border": "zero padding 5",
        "K1": 0.01,
        "K2": 0.03,
        "covariance": "population, not clipped",
        "channels": "mean",
        "precision": "float64",
    },
    libraries=("numpy", "scipy", "scikit-image"),
)
