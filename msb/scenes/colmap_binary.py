"""The binary format of COLMAP models: cameras.bin, images.bin, points3D.bin, all little-endian.

Layouts: `colmap/colmap`: src/colmap/scene/reconstruction_io_binary.cc.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.scenes.colmap_models import MODEL_NAMES, Lens, Shot, model_parameters
from msb.scenes.source import Source

# Layouts of the records in the binary files. Number of records. Camera record: id, model, width, height.
# Image record: id, quaternion, translation, camera id. Point record: id, position, colour, error, track
# length.
_COUNT = struct.Struct("<Q")
_LENS = struct.Struct("<iiQQ")
_SHOT = struct.Struct("<i4d3di")
_POINT = struct.Struct("<Q3d3BdQ")
_POINT_TRACK_LENGTH = _POINT.size - _COUNT.size
_TRACK_ELEMENT = struct.Struct("<ii").size
_POINT_2D = struct.Struct("<ddq").size
# Number of points that are read at once, to limit temporary memory.
_POINTS_AT_A_TIME = 1 << 14


class _Cursor:
    """A position for reading in a binary file. The position never moves past the end of the file."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.size = len(source.data)
        self.at = 0

    @property
    def pointer(self) -> str:
        return f"byte {self.at}"

    def count(self, what: str, least: int) -> int:
        """Return the declared number of records.

        Raise an error if the file is too short for this number of records.
        """
        (count,) = self.take(_COUNT, "the number of records")
        if count * least > self.size - self.at:
            left = self.size - self.at
            text = (
                f"{count} {what} of at least {least} bytes each are declared; the file has {left} more bytes"
            )
            raise self.source.error("COLMAP_INVALID", text, pointer="byte 0")
        return int(count)

    def take(self, layout: struct.Struct, what: str) -> tuple[Any, ...]:
        """Return the values of a record with this layout, and move the position to the end of the record."""
        start = self.skip(layout.size, what)
        return layout.unpack_from(self.source.data, start)

    def skip(self, size: int, what: str) -> int:
        """Skip `size` bytes and return the position of the first skipped byte."""
        start = self.at
        if size > self.size - start:
            text = f"the file ends within {what}, {size - (self.size - start)} bytes too early"
            raise self.source.error("COLMAP_INVALID", text, pointer=self.pointer)
        self.at += size
        return start

    def finish(self) -> None:
        """If bytes are left, raise an error."""
        if self.at < self.size:
            text = f"{self.size - self.at} bytes follow the last declared record"
            raise self.source.error("COLMAP_INVALID", text, pointer=self.pointer)


def read_lenses(source: Source) -> Iterator[Lens]:
    """Yield the records of cameras.bin."""
    cursor = _Cursor(source)
    for index in range(cursor.count("cameras", _LENS.size)):
        pointer, what = cursor.pointer, f"camera {index}"
        number, model, width, height = cursor.take(_LENS, what)
        name = MODEL_NAMES.get(model)
        with source.locating(pointer, f"camera id {number}"):
            size = model_parameters(name, str(model))
        parameters = cursor.take(struct.Struct(f"<{size}d"), what)
        yield Lens(number, str(name), width, height, parameters, pointer)
    cursor.finish()


def count_shots(source: Source) -> int:
    """Return the declared number of images of images.bin."""
    return _Cursor(source).count("images", _SHOT.size + 1 + _COUNT.size)


def read_shots(source: Source) -> Iterator[Shot]:
    """Yield the records of images.bin. The 2D points are skipped."""
    cursor = _Cursor(source)
    for index in range(cursor.count("images", _SHOT.size + 1 + _COUNT.size)):
        pointer, what = cursor.pointer, f"image {index}"
        number, *pose, lens = cursor.take(_SHOT, what)
        end = source.data.find(b"\0", cursor.at)
        if end < 0:
            text = f"the name of {what} does not end"
            raise source.error("COLMAP_INVALID", text, pointer=cursor.pointer)
        name = bytes(source.data[cursor.at : end])
        cursor.skip(len(name) + 1, what)
        (points,) = cursor.take(_COUNT, what)
        cursor.skip(points * _POINT_2D, f"the 2D points of {what}")
        yield Shot(number, tuple(pose[:4]), tuple(pose[4:]), lens, name, pointer)
    cursor.finish()


def read_points(source: Source) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the positions and colours of points3D.bin.

    The records of points have different lengths, because the lengths of their tracks differ. The first pass
    reads the lengths and stores the start of each record. The second pass reads the values in blocks.
    """
    cursor = _Cursor(source)
    count = cursor.count("points", _POINT.size)
    starts = np.frombuffer(_starts_of_points(cursor, count), dtype=np.int64)
    content = np.frombuffer(source.data, dtype=np.uint8)
    xyz = np.zeros((count, 3))
    rgb = np.zeros((count, 3), dtype=np.uint8)
    columns = np.arange(8, 35)
    # Read bytes 8 to 34 of each record: three doubles and three bytes after the id.
    for first in range(0, count, _POINTS_AT_A_TIME):
        part = slice(first, first + _POINTS_AT_A_TIME)
        rows = content[starts[part, None] + columns]
        xyz[part] = np.ascontiguousarray(rows[:, :24]).view("<f8")
        rgb[part] = rows[:, 24:]
    for row in np.flatnonzero(~np.isfinite(xyz).all(axis=1))[:1].tolist():
        text = f"point {row} is at {' '.join(map(str, xyz[row].tolist()))}; coordinates must be finite"
        raise source.error("COLMAP_INVALID", text, pointer=f"byte {starts[row]}")
    return xyz, rgb


def _starts_of_points(cursor: _Cursor, count: int) -> array[int]:
    """Return the offset of each record in bytes. A record that exceeds the file is an error."""
    length_of_track, data, size = _COUNT.unpack_from, cursor.source.data, cursor.size
    starts = array("q")
    at = cursor.at
    for index in range(count):
        starts.append(at)
        if at + _POINT.size <= size:
            at += _POINT.size + _TRACK_ELEMENT * length_of_track(data, at + _POINT_TRACK_LENGTH)[0]
        else:
            at = size + 1
        if at > size:
            text = f"the file ends within point {index} of {count}"
            raise cursor.source.error("COLMAP_INVALID", text, pointer=f"byte {starts[index]}")
    cursor.at = at
    cursor.finish()
    return starts
