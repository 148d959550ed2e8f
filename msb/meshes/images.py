"""Images of textures: decoded only after their header has said how large they are."""

from __future__ import annotations

import io
import struct
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_SIDE
from msb.base.files import library_reason
from msb.errors import MeshFileError

if TYPE_CHECKING:
    from PIL import Image

# Most bytes of one image as it is stored.
MAX_FILE = 1 << 30
MAX_BYTES_PER_BYTE = 1 << 10
MAX_EXTRA_BYTES = 1 << 28
# The memory that the texels of a mesh may take: 1024 bytes per byte of its images (as much as deflate and
# JPEG can stand for) and 256 MiB, in total at most 4 GiB.
MAX_BYTES = 1 << 32
# Of a progressive JPEG, each of which is a pass over all texels. Programs write ten.
_MOST_SCANS = 100


class Decoder:
    """Decodes the images of one mesh, which share an allowance of memory."""

    def __init__(self) -> None:
        self._left = MAX_EXTRA_BYTES
        self._total = MAX_BYTES

    def decode(self, data: bytes | memoryview, *, alpha: bool) -> NDArray[np.uint8]:
        """Return the texels (H, W, 3) of a PNG, JPEG or WebP; (H, W, 4) if it has alpha, and `alpha` counts.

        Raises
        ------
        MeshFileError
            Of no file. MESH_FILE_INVALID: it is damaged, or another kind of image. MESH_FILE_TOO_LARGE: it
            says that it has more texels than are read.
        """
        from PIL import Image, JpegImagePlugin, PngImagePlugin, UnidentifiedImageError, WebPImagePlugin

        # These are imported here, or Pillow imports all that it has, to look for WebP.
        plugins = PngImagePlugin.PngImageFile, JpegImagePlugin.JpegImageFile, WebPImagePlugin.WebPImageFile
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # the size is checked here
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of odd metadata
                if canvas := _webp_canvas(data):
                    self._take(canvas, 8, len(data))  # Pillow's decoder makes two canvases as it opens
                elif bytes(data[:2]) == b"\xff\xd8" and bytes(data).count(b"\xff\xda") > _MOST_SCANS:
                    text = f"it has more than {_MOST_SCANS} scans; save it as an ordinary JPEG"
                    raise MeshFileError("MESH_FILE_TOO_LARGE", text)
                with Image.open(io.BytesIO(data), formats=[each.format for each in plugins]) as image:
                    if not canvas:
                        self._take(image.size, 4, len(data))
                    return _texels(image, alpha=alpha)
        except MeshFileError:
            raise
        except MemoryError:
            text = "this machine has not enough memory for its texels"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text) from None
        except UnidentifiedImageError:
            text = "it is no PNG, JPEG or WebP image, or damaged within its header"
            raise MeshFileError("MESH_FILE_INVALID", text) from None
        except Exception as error:  # decoders raise all kinds of things about damaged files
            text = f"it cannot be decoded: {library_reason(error)}"
            raise MeshFileError("MESH_FILE_INVALID", text) from None
        finally:
            Image.MAX_IMAGE_PIXELS = limit

    def _take(self, size: tuple[int, int], width: int, stored: int) -> None:
        """Refuse an image of this size, `width` bytes a texel, that is larger than its file can stand for."""
        if not 0 < min(size) <= max(size) <= MAX_SIDE:
            text = f"it is {size[0]} x {size[1]}; a texture has at most {MAX_SIDE} texels a side"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text)
        self._left += stored * MAX_BYTES_PER_BYTE
        needed = size[0] * size[1] * width
        if needed > min(self._left, self._total):
            text = f"its {size[0]} x {size[1]} texels need {needed} bytes, too many for files of this size"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text)
        self._left -= needed
        self._total -= needed


def _texels(image: Image.Image, *, alpha: bool) -> NDArray[np.uint8]:
    if image.mode.startswith("I"):  # 16 bits of grey, which Pillow would cut off at 255
        grey = (np.asarray(image, np.uint32) * 255 + 32767) // 65535
        return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    has_alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
    mode = "RGBA" if alpha and has_alpha else "RGB"
    return np.array(image if image.mode == mode else image.convert(mode))


def _webp_canvas(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return width and height of a WebP, None of another file (RFC 9649).

    Pillow takes memory for the canvas as soon as it opens one.
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
