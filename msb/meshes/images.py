"""Decodes texture images from files that are not trusted.

The image size in the header is checked before decoding.
"""

from __future__ import annotations

import io
import struct
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_SIDE
from msb.base.files import library_reason
from msb.errors import MeshFileError, shorten

if TYPE_CHECKING:
    from PIL import Image

# Largest image file in bytes: 1 GiB.
MAX_FILE = 1 << 30
# Memory limit for all texels of a mesh: 256 MiB, plus 1024 bytes per byte of the image files, and at most 4
# GiB in total. 1024 is the highest compression ratio of deflate and JPEG.
MAX_BYTES_PER_BYTE = 1 << 10
MAX_EXTRA_BYTES = 1 << 28
MAX_BYTES = 1 << 32
# Maximum number of scans of a progressive JPEG. The decoder processes all texels again for every scan. Usual
# encoders write about ten scans.
_MAX_SCANS = 100


class Decoder:
    """Decoder for the images of one mesh, which share one memory limit."""

    def __init__(self) -> None:
        self._left = MAX_EXTRA_BYTES
        self._total = MAX_BYTES

    def decode(self, data: bytes | memoryview, *, alpha: bool) -> NDArray[np.uint8]:
        """Return the texels (H, W, 3) of a PNG, JPEG or WebP file.

        With `alpha`, an alpha channel is kept as (H, W, 4).

        Raises
        ------
        MeshFileError
            The error has no file name. MESH_FILE_INVALID: the image is damaged or has another format.
            MESH_FILE_TOO_LARGE: the image exceeds the size limit or the memory limit.
        """
        from PIL import Image, JpegImagePlugin, PngImagePlugin, UnidentifiedImageError, WebPImagePlugin

        # Importing only three plugins prevents Pillow from importing all its plugins.
        plugins = PngImagePlugin.PngImageFile, JpegImagePlugin.JpegImageFile, WebPImagePlugin.WebPImageFile
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # `_take` checks the image size.
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about unusual metadata
                if canvas := _read_webp_size(data):
                    self._take(canvas, 8, len(data))  # Pillow allocates two canvases for a WebP file.
                elif bytes(data[:2]) == b"\xff\xd8" and bytes(data).count(b"\xff\xda") > _MAX_SCANS:
                    text = f"the JPEG has more than {_MAX_SCANS} scans; save it as a baseline JPEG"
                    raise MeshFileError("MESH_FILE_TOO_LARGE", text)
                with Image.open(io.BytesIO(data), formats=[plugin.format for plugin in plugins]) as image:
                    if not canvas:
                        self._take(image.size, 4, len(data))
                    return _read_texels(image, alpha=alpha)
        except MeshFileError:
            raise
        except MemoryError:
            text = "not enough memory to decode the image"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text) from None
        except UnidentifiedImageError:
            text = "the file is not a PNG, JPEG or WebP image, or its header is damaged"
            raise MeshFileError("MESH_FILE_INVALID", text) from None
        except Exception as error:  # Decoders raise many exception types for damaged files.
            text = f"the image cannot be decoded: {library_reason(error)}"
            raise MeshFileError("MESH_FILE_INVALID", text) from None
        finally:
            Image.MAX_IMAGE_PIXELS = limit

    def _take(self, size: tuple[int, int], width: int, stored: int) -> None:
        """Reserve memory for an image.

        The argument `size` is the (width, height) of the image. A texel has `width` bytes. The image file has
        `stored` bytes. Raise MESH_FILE_TOO_LARGE if the memory limit is exceeded.
        """
        if not 0 < min(size) <= max(size) <= MAX_SIDE:
            text = f"the image is {size[0]} x {size[1]}; at most {MAX_SIDE} texels a side are supported"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text)
        self._left += stored * MAX_BYTES_PER_BYTE
        needed = size[0] * size[1] * width
        if needed > min(self._left, self._total):
            text = f"{size[0]} x {size[1]} texels need {needed} bytes, too many for image files of this size"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text)
        self._left -= needed
        self._total -= needed


def describe_lost_image(name: str, reason: str) -> str:
    """Return the entry in `Mesh.left_out` for an image that cannot be read."""
    return f"image {shorten(name, 60)} ({shorten(reason, 200)}; its faces have no texture)"


def _read_texels(image: Image.Image, *, alpha: bool) -> NDArray[np.uint8]:
    """Return the texels (H, W, 3 | 4) of an opened image as uint8."""
    if image.mode.startswith("I"):  # Pillow would clip 16-bit grey values.
        grey = (np.asarray(image, np.uint32) * 255 + 32767) // 65535
        return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    has_alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
    mode = "RGBA" if alpha and has_alpha else "RGB"
    return np.array(image if image.mode == mode else image.convert(mode))


def _read_webp_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return width and height of a WebP file (RFC 9649), or None for other files.

    The size must be checked before Pillow opens the file, because Pillow then allocates the canvas.
    """
    head = bytes(data[:30]).ljust(30, b"\0")
    if head[:4] != b"RIFF" or head[8:12] != b"WEBP":
        return None
    kind = head[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(head[24:27], "little"), 1 + int.from_bytes(head[27:30], "little")
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", head, 21)[0]
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", head, 26)
    return width & 0x3FFF, height & 0x3FFF
