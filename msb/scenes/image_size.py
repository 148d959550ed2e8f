"""Size and channels of a PNG or JPEG image, from its header, without decoding pixels."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.files import library_reason, map_file
from msb.scenes.checks import check_size
from msb.scenes.source import Source

if TYPE_CHECKING:
    from PIL import Image

# Suffixes of photographs, in lower case.
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
# Bytes that are searched for a header: colour profiles, thumbnails and depth maps before it take a few MiB.
_MOST_BYTES = 1 << 23


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return (width, height) in pixels as stored, ignoring an orientation in the metadata."""
    with _header(path) as image:
        return check_size(image.size)


def has_alpha(path: str | os.PathLike[str]) -> bool:
    """Return whether an image has an alpha channel; a transparent palette colour does not count."""
    with _header(path) as image:
        return image.mode in ("LA", "RGBA")


@contextlib.contextmanager
def _header(path: str | os.PathLike[str]) -> Iterator[Image.Image]:
    """Yield an image after Pillow has read only its header."""
    from PIL import Image, UnidentifiedImageError

    source = Source(Path(path), map_file(Path(path), _MOST_BYTES))
    file: Any = source.data  # a memory mapping, which is read like a file
    try:
        if not file:
            raise ValueError("it is empty")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about large sizes (checked here) and odd metadata
            image = Image.open(file, formats=("PNG", "JPEG"))
    except Exception as error:  # damaged files raise various exceptions
        reason = "" if isinstance(error, UnidentifiedImageError) else f" ({library_reason(error)})"
        text = f"it is not a PNG or JPEG image, or its header is damaged{reason}"
        raise source.error("CAMERA_IMAGE", text) from None
    with source.locating(None):
        yield image
