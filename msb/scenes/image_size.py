"""Read size, channels and orientation of a photograph from its header, without decoding pixels."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.files import library_reason, map_file
from msb.scenes.checks import check_size
from msb.scenes.source import Source

if TYPE_CHECKING:
    from PIL import Image

# Suffixes of photographs, in lower case.
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".avif", ".heic", ".heif")
# Number of bytes searched for an image header. Colour profiles, thumbnails and depth maps before the image
# header need a few MiB.
_MOST_BYTES = 1 << 23
# Signatures of image formats whose header can be anywhere in the file. The signature of TIFF and WebP is at
# byte 0, the signature of AVIF and HEIC at byte 4.
_SCATTERED = (b"II*\0", b"MM\0*", b"RIFF")
_BOX = b"ftyp"
_HEIC = (b"heic", b"heix", b"hevc", b"heim", b"heis", b"mif1", b"msf1")
# EXIF tag of the orientation. The value 1 means upright, and the values 5 to 8 swap the axes.
_ORIENTATION = 0x0112


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image: (width, height) as stored, Pillow's format and mode, EXIF orientation."""

    size: tuple[int, int]
    format: str
    mode: str
    orientation: int = 1

    @property
    def has_alpha(self) -> bool:
        """Whether the image has an alpha channel. A transparent palette colour is not an alpha channel."""
        return self.mode in ("LA", "RGBA")


def image_formats() -> tuple[str, ...]:
    """Return Pillow's names of the photograph formats that it can read."""
    from PIL import Image

    Image.init()
    return tuple(name for name in ("PNG", "JPEG", "WEBP", "TIFF", "AVIF", "HEIF") if name in Image.OPEN)


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return (width, height) of the stored pixels, without applying an orientation in the metadata."""
    return read_header(path).size


def read_header(path: str | os.PathLike[str]) -> ImageHeader:
    """Return the header of an image.

    Raise CAMERA_IMAGE for a damaged image and CAMERA_INVALID for a too large image.
    """
    with _open_header(path) as image:
        return ImageHeader(check_size(image.size), str(image.format), image.mode, _read_orientation(image))


def _read_orientation(image: Image.Image) -> int:
    """Return the EXIF orientation, or 1 if it is missing or damaged.

    For TIFF, return 1, because Pillow rotates the image.
    """
    from PIL import Image

    value: Any = 1
    with contextlib.suppress(Exception):  # damaged EXIF data raise various exceptions
        if image.format != "TIFF" and (data := image.info.get("exif")):
            exif = Image.Exif()
            exif.load(data)
            value = exif.get(_ORIENTATION, 1)
    return value if value in range(1, 9) else 1


@contextlib.contextmanager
def _open_header(path: str | os.PathLike[str]) -> Iterator[Image.Image]:
    """Yield an image whose header was read. No pixels are decoded."""
    from PIL import Image, UnidentifiedImageError

    source = Source(Path(path), map_file(Path(path), _MOST_BYTES))
    start = bytes(source.data[:12])
    if start.startswith(_SCATTERED) or start[4:8] == _BOX:
        source = Source(Path(path), map_file(Path(path)))
    file: Any = source.data  # Pillow reads a memory mapping like a file
    try:
        if not file:
            raise ValueError("it is empty")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # hide warnings about sizes and metadata
            image = Image.open(file, formats=image_formats())
    except Exception as error:  # damaged files raise various exceptions
        reason = "" if isinstance(error, UnidentifiedImageError) else f" ({library_reason(error)})"
        text = f"it is not a PNG, JPEG, WebP, TIFF or AVIF image, or its header is damaged{reason}"
        if start[4:8] == _BOX and start[8:12] in _HEIC:
            text = "it is a HEIC image, which Pillow cannot read; convert it to JPEG"
        raise source.error("CAMERA_IMAGE", text) from None
    with source.locating(None):
        yield image
