"""What the header of a PNG or JPEG image says, its size above all, without decoding a pixel."""

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
# Most bytes in which a header is looked for: colour profiles, thumbnails and depth maps take a few MiB.
_MOST_BYTES = 1 << 23


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return (width, height) in pixels, as stored: an orientation in the metadata is not applied."""
    with _header(path) as image:
        return check_size(image.size)


def has_alpha(path: str | os.PathLike[str]) -> bool:
    """Return whether an image has an alpha channel; a colour marked as transparent does not count."""
    with _header(path) as image:
        return image.mode in ("LA", "RGBA")


@contextlib.contextmanager
def _header(path: str | os.PathLike[str]) -> Iterator[Image.Image]:
    """Yield an image of which Pillow has read the header alone."""
    from PIL import Image, UnidentifiedImageError

    source = Source(Path(path), map_file(Path(path), _MOST_BYTES))
    file: Any = source.data  # a mapping is a file, of which only the pages that are read take memory
    try:
        if not file:
            raise ValueError("it is empty")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of sizes, which are checked here, and of odd metadata
            image = Image.open(file, formats=("PNG", "JPEG"))
    except Exception as error:  # damaged files raise all kinds of things
        reason = "" if isinstance(error, UnidentifiedImageError) else f" ({library_reason(error)})"
        text = f"it is neither a PNG nor a JPEG image, or damaged within its header{reason}"
        raise source.error("CAMERA_IMAGE", text) from None
    with source.locating(None):
        yield image
