"""Read the header of a PNG or JPEG image, its size above all, without decoding a pixel."""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

from msb.scenes.checks import check_size
from msb.scenes.source import Source

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Suffixes of photographs, in lower case."""
_PNG = b"\x89PNG\r\n\x1a\n"
_MARKER = re.compile(rb"\xff+([^\xff])", re.DOTALL)
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""JPEG markers SOF0..SOF15 without DHT, JPG and DAC, which share their range."""
_END_OF_HEADERS = {0xD9, 0xDA}
_MAX_SEGMENTS = 4096
"""Most segments of a JPEG. Each has at most 64 KiB; metadata, colour profiles and depth maps take some
hundreds."""


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return (width, height) in pixels, as stored: an orientation in the metadata is not applied.

    Notes
    -----
    PNG: W3C Portable Network Graphics, 5.2 and 11.2.2: the first chunk is IHDR. JPEG: ITU-T T.81, annex B:
    segments up to the frame header, whose fields are precision, lines and samples per line.
    """
    source = Source.open(Path(path))
    found = _png(source) or _jpeg(source)
    if found is None:
        text = "it is neither a PNG nor a JPEG image, or it ends within its header"
        raise source.error("CAMERA_IMAGE", text)
    with source.locating(None):
        return check_size(found)


def has_alpha(path: str | os.PathLike[str]) -> bool:
    """Return whether an image is a PNG with an alpha channel; a colour marked as transparent does not count.

    Notes
    -----
    W3C Portable Network Graphics, 11.2.2: colour types 4 and 6.
    """
    source = Source.open(Path(path))
    return _png(source) is not None and bytes(source.data[25:26]) in (b"\4", b"\6")


def _png(source: Source) -> tuple[int, int] | None:
    head = bytes(source.data[:24])
    if len(head) < 24 or not head.startswith(_PNG) or head[8:16] != b"\0\0\0\rIHDR":
        return None
    width, height = struct.unpack(">II", head[16:])
    return width, height


def _jpeg(source: Source) -> tuple[int, int] | None:
    data = source.data
    if bytes(data[:2]) != b"\xff\xd8":
        return None
    at = 2
    for _ in range(_MAX_SEGMENTS):
        marker = _MARKER.match(data, at)
        if marker is None or marker[1][0] in _END_OF_HEADERS:
            return None
        at = marker.end()
        head = bytes(data[at : at + 7])
        if marker[1][0] in _FRAMES:
            if len(head) < 7:
                return None
            height, width = struct.unpack(">HH", head[3:])
            return width, height
        if len(head) < 2:
            return None
        at += max(2, int.from_bytes(head[:2], "big"))
    return None
