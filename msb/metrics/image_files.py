"""Read images for evaluation from untrusted files: PNG, JPEG, NumPy and OpenEXR."""

import contextlib
import io
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb.base.files import library_reason, regular_file
from msb.errors import MetricError, shorten
from msb.scenes.image_size import image_formats

Color = tuple[float, float, float]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".npy", ".exr")
# Maximum width and height of an image in pixels.
MAX_SIDE = 65_535
# Maximum number of pixels of an image: 67 million, more than in any benchmark. Checked before decoding.
MAX_PIXELS = 1 << 26
_NPY = b"\x93NUMPY"
# Number of bytes of a PNG header: signature, length and type of IHDR, width, height, bit depth, colour type.
_PNG_HEAD = 26


def read_image(path: str | os.PathLike[str], *, background: Color | None = None) -> NDArray[Any]:
    """Return an image (H, W, 3) from a file. PNG and JPEG give bytes, and .npy and .exr give floats.

    The suffix determines the format. PNG and JPEG have 8-bit RGB, and PNG optionally has alpha. NPY contains
    (H, W, 3) uint8 or float. EXR has the channels R, G, B. Orientation, gamma and colour profiles are
    ignored. Partly transparent pixels become rgb a + background (1 - a), with values in [0, 1], in float64
    without rounding. If alpha is 255 everywhere, no background is needed.
    """
    place = regular_file(path)
    suffix = place.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise _file_error(place, f"unsupported suffix; use one of {', '.join(IMAGE_SUFFIXES)}")
    if suffix == ".exr":
        need_extra("bench", "OpenEXR", what="an EXR image")
    with _decoding(place):
        if suffix == ".npy":
            return _read_npy(place)
        if suffix == ".exr":
            return _read_exr(place)
        return _composite(place, read_pixels(place), background)


@contextlib.contextmanager
def _decoding(path: Path) -> Iterator[None]:
    try:
        yield
    except MetricError:
        raise
    except Exception as error:  # decoders raise various exceptions for damaged files
        raise _file_error(path, f"it cannot be decoded: {library_reason(error)}") from error


def _file_error(path: Path, message: str) -> MetricError:
    return MetricError("METRIC_IMAGE", message, file=path)


def _check_size(path: Path, width: int, height: int) -> None:
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and width * height <= MAX_PIXELS):
        text = f"{width} x {height} pixels are too many; limits: {MAX_SIDE} per side, {MAX_PIXELS} in all"
        raise _file_error(path, text)


def read_pixels(path: Path, modes: tuple[str, ...] = ("RGB", "RGBA")) -> NDArray[np.uint8]:
    """Return the stored pixels of an image file: (H, W, 3), or (H, W, 4) with alpha.

    `modes` lists the accepted Pillow modes. Grey images in mode "L" give (H, W), and "LA" gives (H, W, 2).
    """
    path = regular_file(path)
    with _decoding(path):
        return _decode(path, modes)


def read_mask(path: Path) -> NDArray[np.uint8]:
    """Return the first channel (H, W) of a mask. The file may also be a grey image."""
    pixels = read_pixels(path, ("L", "RGB", "RGBA"))
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[..., 0])


def _decode(path: Path, modes: tuple[str, ...]) -> NDArray[np.uint8]:
    from PIL import Image

    _check_png_kind(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `_check_size` has already checked the size
        image = Image.open(path, formats=image_formats())
    with image:
        _check_size(path, *image.size)
        if "transparency" in image.info:
            raise _file_error(path, "unsupported transparent colour; use an alpha channel or no transparency")
        if image.mode not in modes:
            raise _file_error(path, f"unsupported pixel format {image.mode}; use 8-bit RGB or RGBA")
        image.load()
        pixels: NDArray[np.uint8] = np.array(image)
    return pixels


def _composite(path: Path, pixels: NDArray[np.uint8], background: Color | None) -> NDArray[Any]:
    if pixels.shape[2] == 3:
        return pixels
    color, alpha = pixels[..., :3], pixels[..., 3]
    if (alpha == 255).all():
        return np.ascontiguousarray(color)
    if background is None:
        share = np.count_nonzero(alpha != 255) / alpha.size
        text = f"{share:.0%} of the pixels are not opaque, and no background colour was given"
        raise MetricError("METRIC_IMAGE_ALPHA", text, file=path)
    # Compute in place and one channel at a time. The floats of the largest image need 1.5 GiB of memory.
    image = color / 255.0
    weight = alpha / 255.0
    image *= weight[..., None]
    np.subtract(1, weight, out=weight)
    for channel, value in enumerate(background):
        image[..., channel] += value * weight
    return image


def _check_png_kind(path: Path) -> None:
    """Reject 16-bit files, which Pillow would silently convert to 8-bit RGB."""
    with path.open("rb") as file:
        head = file.read(_PNG_HEAD)
    if not head.startswith(b"\x89PNG\r\n\x1a\n"):
        return
    if len(head) < _PNG_HEAD:
        raise _file_error(path, "the file ends within its header")
    depth, kind = head[24], head[25]
    if kind == 3:
        raise _file_error(path, "unsupported palette colours; use 8-bit RGB or RGBA")
    if depth != 8:
        raise _file_error(path, f"unsupported {depth} bits per channel; use 8")


def _read_npy(path: Path) -> NDArray[Any]:
    # Map the file into memory, so that the header is checked against the file size before reading. Pickled
    # objects are not loaded.
    with path.open("rb") as file:
        if file.read(len(_NPY)) != _NPY:
            raise _file_error(path, "the file is not an array written by numpy.save")
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.ndim != 3 or array.shape[2] != 3:
        shape = " x ".join(map(str, array.shape))
        raise _file_error(path, f"the array has shape {shape}; it must be height x width x 3")
    if array.dtype != np.uint8 and array.dtype.kind != "f":
        raise _file_error(path, f"unsupported dtype {shorten(str(array.dtype), 40)}; use uint8 or floats")
    _check_size(path, array.shape[1], array.shape[0])
    return np.array(array)


def _read_exr(path: Path) -> NDArray[Any]:
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        corners = np.asarray(file.header()["dataWindow"], np.int64)
    width, height = (int(side) for side in corners[1] - corners[0] + 1)
    _check_size(path, width, height)
    printed = io.StringIO()  # for unreadable pixels, the library prints a message and returns zeros
    with contextlib.redirect_stdout(printed), OpenEXR.File(str(path)) as file:
        channels = file.channels()
        names = ", ".join(sorted(channels)) or "none"
        pixels = channels["RGB"].pixels if "RGB" in channels else None
    if printed.getvalue():
        raise _file_error(path, f"it cannot be decoded: {shorten(printed.getvalue().strip())}")
    if pixels is None or pixels.ndim != 3:
        raise _file_error(path, f"unsupported channels {shorten(names)}; use R, G and B of equal size")
    return np.array(pixels, np.float32)
