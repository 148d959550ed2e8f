"""Read Gaussians from an `.spz` file (nianticlabs/spz at 21715c3), versions 1 to 4.

Versions 1 to 3 are one gzip stream: a header of 16 bytes, then a column for each parameter. Version 4 has an
uncompressed header of 32 bytes. Each column of parameters is a Zstandard stream. The frame of the file is x
right, y up, z back.
"""

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb.errors import CheckpointError, shorten
from msb.splats.gaussians import (
    Gaussians,
    Reals,
    check_count,
    damaged,
    expand_quaternions,
    to_logit,
    turn_about_x,
)

_MAGIC = 0x5053474E
_HEADER = struct.Struct("<IIIBBBB")
# First version with Zstandard streams, and the newest supported version.
_FIRST_ZSTD, _NEWEST = 4, 4
# The last byte of the header is the number of streams; the offset of the stream table follows this byte.
_TABLE_OFFSET = struct.Struct("<I")
_ENTRY = struct.Struct("<QQ")
_MAX_STREAMS = 16
_ANTIALIASED, _HAS_RECORDS = 1, 2
_COLOR_SCALE = 0.15
# Memory limit for the decompressed columns in bytes: 16 per byte of the file, plus 64 MiB. Real files are
# compressed by factors of 1 to 3.
_MAX_BYTES_PER_BYTE, _MAX_EXTRA_BYTES = 16, 1 << 26


@dataclass(frozen=True)
class _Header:
    magic: int
    version: int
    count: int
    degree: int
    fraction_bits: int
    flags: int
    streams: int

    @property
    def widths(self) -> dict[str, int]:
        """Number of bytes of each parameter per Gaussian. The parameters are in the order of the file."""
        return {
            "mean": 6 if self.version == 1 else 9,
            "opacity": 1,
            "color": 3,
            "scale": 3,
            "rotation": 3 if self.version < 3 else 4,
            "rest": 3 * ((self.degree + 1) ** 2 - 1),
        }


def read(data: memoryview) -> Gaussians:
    """Return the Gaussians of an `.spz` file.

    Raises
    ------
    CheckpointError
        CHECKPOINT_DAMAGED: the file is truncated, changed, or needs too much memory for its size.
        CHECKPOINT_FORM: the version or the SH degree of the file is unknown. CHECKPOINT_LAYOUT: the file has
        no Gaussians.
    UsageError
        EXTRA_MISSING: version 4 needs the extra `compressed`.
    """
    limit = _MAX_BYTES_PER_BYTE * len(data) + _MAX_EXTRA_BYTES
    if bytes(data[:2]) == b"\x1f\x8b":
        stream = zlib.decompressobj(wbits=31)
        try:
            header = _parse_header(stream.decompress(data, _HEADER.size))
            size = _check_size(header, limit)
            body = stream.decompress(stream.unconsumed_tail, size)
        except zlib.error as error:
            raise damaged(f"the file cannot be decompressed: {shorten(str(error))}") from None
    else:
        header = _parse_header(bytes(data[: _HEADER.size]))
        if header.version < _FIRST_ZSTD:
            raise damaged(f"version {header.version} is stored without gzip")
        size = _check_size(header, limit)
        body = _decompress_streams(data, header)
    if len(body) < size:
        raise damaged(f"the file has {len(body)} bytes for {header.count} Gaussians, which need {size}")
    return turn_about_x(_decode(header, body))


def _parse_header(data: bytes) -> _Header:
    if len(data) < _HEADER.size:
        raise damaged(f"the file ends in its header of {_HEADER.size} bytes")
    header = _Header(*_HEADER.unpack(data))
    if header.magic != _MAGIC:
        raise damaged("the file does not begin with the signature of an .spz file")
    if not 1 <= header.version <= _NEWEST or header.degree > 4:
        text = f"version {header.version} with SH degree {header.degree} is not supported; "
        text += f"use a file of version 1 to {_NEWEST} with degree 0 to 4"
        raise CheckpointError("CHECKPOINT_FORM", text)
    check_count(header.count)
    return header


def _check_size(header: _Header, limit: int) -> int:
    """Return the size of all columns in bytes. Raise an error if the size exceeds the memory limit."""
    size = header.count * sum(header.widths.values())
    if size > limit:
        text = f"the header declares {header.count} Gaussians with {size} bytes, too many for the file size"
        raise damaged(text)
    return size


def _decompress_streams(data: memoryview, header: _Header) -> bytes:
    """Return the columns of a file of version 4; a table lists their streams one after another."""
    need_extra("compressed", "zstandard", what="an .spz file of version 4")
    import zstandard

    end = _HEADER.size + _TABLE_OFFSET.size
    if len(data) < end or not 0 < header.streams <= _MAX_STREAMS:
        raise damaged(f"the file declares {header.streams} streams; 1 to {_MAX_STREAMS} are valid")
    (table,) = _TABLE_OFFSET.unpack_from(data, _HEADER.size)
    at = table + header.streams * _ENTRY.size
    if at > len(data):
        raise damaged("the table of streams is truncated")
    # Each stream holds one column. Decompression stops at the expected size of the column.
    widths = [width for width in header.widths.values() if width]
    columns = []
    for number, width in zip(range(header.streams), widths, strict=False):
        packed, _ = _ENTRY.unpack_from(data, table + number * _ENTRY.size)
        if packed > len(data) - at:
            raise damaged(f"stream {number} is truncated")
        size = width * header.count
        try:
            reader = zstandard.ZstdDecompressor().stream_reader(bytes(data[at : at + packed]))
            column = reader.read(size)
        except zstandard.ZstdError as error:
            text = f"stream {number} cannot be decompressed: {shorten(str(error))}"
            raise damaged(text) from None
        if len(column) < size:
            raise damaged(f"stream {number} has {len(column)} bytes; {size} are needed")
        columns.append(column)
        at += packed
    return b"".join(columns)


def _decode(header: _Header, body: bytes) -> Gaussians:
    """Return the Gaussians of the columns in `body`, in the frame of the file."""
    count, start, columns = header.count, 0, {}
    for name, width in header.widths.items():
        columns[name] = np.frombuffer(body, np.uint8, count * width, start).reshape(count, width)
        start += count * width
    rest = None
    if header.degree:
        rest = (columns["rest"].reshape(count, -1, 3).astype(np.float32) - 128) / np.float32(128)
    notes = ("additional data of the program that wrote the file",) if header.flags & _HAS_RECORDS else ()
    return Gaussians(
        mean=_decode_means(header, columns["mean"]),
        scale=(columns["scale"] / 16 - 10).astype(np.float32),
        rotation=_decode_rotations(header, columns["rotation"]).astype(np.float32),
        opacity=to_logit(columns["opacity"][:, 0] / 255),
        f_dc=((columns["color"] / 255 - 0.5) / _COLOR_SCALE).astype(np.float32),
        f_rest=rest,
        antialiased=bool(header.flags & _ANTIALIASED),
        notes=notes,
    )


def _decode_means(header: _Header, column: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return means (N, 3): half floats in version 1, otherwise 24-bit fixed-point integers."""
    if header.version == 1:
        return np.ascontiguousarray(column).view("<f2").astype(np.float32)
    low, middle, high = column.reshape(-1, 3, 3).astype(np.int32).transpose(2, 0, 1)
    fixed = (low | middle << 8 | high << 16) << 8 >> 8  # the two shifts extend the sign bit
    return np.ldexp(fixed.astype(np.float32), -header.fraction_bits)


def _decode_rotations(header: _Header, column: NDArray[np.uint8]) -> Reals:
    """Return quaternions (N, 4) w, x, y, z. Before version 3 the file stores x, y and z as bytes.
    From version 3 on, the file stores the three smallest components."""
    if header.version < 3:
        xyz = column / 127.5 - 1
        w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(axis=1)))
        return np.column_stack([w, xyz])
    word = np.ascontiguousarray(column).view("<u4")[:, 0]
    parts = np.stack([(word >> np.uint32(shift)) & np.uint32(1023) for shift in (20, 10, 0)], axis=1)
    others = np.where(parts & 512, -1, 1) * (parts & 511) / 511 * np.sqrt(0.5)
    xyzw = expand_quaternions(word >> np.uint32(30), others)
    return np.roll(xyzw, 1, axis=1)
