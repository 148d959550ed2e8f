"""Read images to be evaluated from untrusted files: PNG, JPEG, NumPy and OpenEXR."""

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

Color = tuple[float, float, float]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".npy", ".exr")
MAX_SIDE = 65_535
# Most pixels of an image: 67 million, more than any benchmark has. Checked before a pixel is decoded.
MAX_PIXELS = 1 << 26
_NPY = b"\x93NUMPY"
# The head of a PNG: signature, length and type of IHDR, width, height, bit depth, colour type.
_PNG_HEAD = 26


def read_image(path: str | os.PathLike[str], *, background: Color | None = None) -> NDArray[Any]:
    """Return the image in a file as (H, W, 3): bytes of a PNG or JPEG, floats of .npy or .exr, as stored.

    The suffix says the format. A PNG or JPEG has 8-bit RGB, a PNG also with alpha; NPY holds (H, W, 3) uint8
    or float; EXR has the channels R, G, B. An orientation, gamma or colour profile is not applied. Partly
    transparent pixels are laid over `background`, in [0, 1], in float64 and without rounding:
    rgb a + background (1 - a). An image whose alpha is 255 everywhere needs none.
    """
    place = regular_file(path)
    suffix = place.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise _bad(place, f"the suffix must be one of {', '.join(IMAGE_SUFFIXES)}")
    if suffix == ".exr":
        need_extra("bench", "OpenEXR", what="an EXR image")
    with _decoding(place):
        if suffix == ".npy":
            return _read_npy(place)
        if suffix == ".exr":
            return _read_exr(place)
        return _composited(place, read_pixels(place), background)


@contextlib.contextmanager
def _decoding(path: Path) -> Iterator[None]:
    try:
        yield
    except MetricError:
        raise
    except Exception as error:  # decoders raise all kinds of things about damaged files
        raise _bad(path, f"it cannot be decoded: {library_reason(error)}") from error


def _bad(path: Path, message: str) -> MetricError:
    return MetricError("METRIC_IMAGE", message, file=path)


def _check_size(path: Path, width: int, height: int) -> None:
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and width * height <= MAX_PIXELS):
        text = f"it is {width} x {height} pixels; a side may have {MAX_SIDE}, the image {MAX_PIXELS}"
        raise _bad(path, text)


def read_pixels(path: Path, modes: tuple[str, ...] = ("RGB", "RGBA")) -> NDArray[np.uint8]:
    """Return the pixels of a PNG or JPEG as stored, (H, W, 3), or with alpha (H, W, 4).

    `modes` are Pillow's names of the kinds of pixels that are accepted; "L", grey, gives (H, W).
    """
    path = regular_file(path)
    with _decoding(path):
        return _read_picture(path, modes)


def read_mask(path: Path) -> NDArray[np.uint8]:
    """Return the first channel of a mask, (H, W); the file may also be grey."""
    pixels = read_pixels(path, ("L", "RGB", "RGBA"))
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[..., 0])


def _read_picture(path: Path, modes: tuple[str, ...]) -> NDArray[np.uint8]:
    from PIL import Image

    _check_png_kind(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which are checked here
        picture = Image.open(path, formats=("PNG", "JPEG"))
    with picture:
        _check_size(path, *picture.size)
        if "transparency" in picture.info:
            raise _bad(path, "it names one colour as transparent; store an alpha channel, or none")
        if picture.mode not in modes:
            raise _bad(path, f"its pixels are of kind {picture.mode}; they must be 8-bit RGB or RGBA")
        picture.load()
        pixels: NDArray[np.uint8] = np.array(picture)
    return pixels


def _composited(path: Path, pixels: NDArray[np.uint8], background: Color | None) -> NDArray[Any]:
    if pixels.shape[2] == 3:
        return pixels
    color, alpha = pixels[..., :3], pixels[..., 3]
    if (alpha == 255).all():
        return np.ascontiguousarray(color)
    if background is None:
        share = np.count_nonzero(alpha != 255) / alpha.size
        text = f"{share:.0%} of its pixels are not opaque, and no background was given to lay them over"
        raise MetricError("METRIC_IMAGE_ALPHA", text, file=path)
    # In place and a channel at a time: an image of the most pixels has 1.5 GiB of floats.
    image = color / 255.0
    weight = alpha / 255.0
    image *= weight[..., None]
    np.subtract(1, weight, out=weight)
    for channel, value in enumerate(background):
        image[..., channel] += value * weight
    return image


def _check_png_kind(path: Path) -> None:
    """Refuse what Pillow would silently turn into 8-bit RGB: it drops the lower half of 16-bit values."""
    with path.open("rb") as file:
        head = file.read(_PNG_HEAD)
    if not head.startswith(b"\x89PNG\r\n\x1a\n"):
        return
    if len(head) < _PNG_HEAD:
        raise _bad(path, "it ends within its header")
    depth, kind = head[24], head[25]
    if kind == 3:
        raise _bad(path, "its colours are in a palette; they must be 8-bit RGB or RGBA")
    if depth != 8:
        raise _bad(path, f"it has {depth} bits per channel; it must have 8")


def _read_npy(path: Path) -> NDArray[Any]:
    # Mapped: the header is checked against the size of the file before anything is read. No pickle.
    with path.open("rb") as file:
        if file.read(len(_NPY)) != _NPY:
            raise _bad(path, "it is not an array as numpy.save writes one")
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.ndim != 3 or array.shape[2] != 3:
        shape = " x ".join(map(str, array.shape))
        raise _bad(path, f"its array is {shape}; it must be height x width x 3")
    if array.dtype != np.uint8 and array.dtype.kind != "f":
        raise _bad(path, f"its values are {shorten(str(array.dtype), 40)}; they must be uint8 or floats")
    _check_size(path, array.shape[1], array.shape[0])
    return np.array(array)


def _read_exr(path: Path) -> NDArray[Any]:
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        corners = np.asarray(file.header()["dataWindow"], np.int64)
    width, height = (int(side) for side in corners[1] - corners[0] + 1)
    _check_size(path, width, height)
    said = io.StringIO()  # of pixels it cannot read the library only prints that, and gives zeros
    with contextlib.redirect_stdout(said), OpenEXR.File(str(path)) as file:
        channels = file.channels()
        names = ", ".join(sorted(channels)) or "none"
        pixels = channels["RGB"].pixels if "RGB" in channels else None
    if said.getvalue():
        raise _bad(path, f"it cannot be decoded: {shorten(said.getvalue().strip())}")
    if pixels is None or pixels.ndim != 3:
        raise _bad(path, f"its channels are {shorten(names)}; they must be R, G and B of one size")
    return np.array(pixels, np.float32)
