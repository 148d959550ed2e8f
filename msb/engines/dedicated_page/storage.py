"""Lossless compression of arrays for an HTML page.

An array becomes a head (JSON data) and a zlib stream, which browsers can inflate; web/store.js reads both.
The key `how` of the head names the encoding of the stream:

- "plain": the values. If `delta` is set, integers are stored as differences between consecutive rows, modulo
  2^32.

- "palette": for columns with at most 256 distinct values: 8-bit codes of all columns, then 256 values per
  column.

- "rows": for at most 65,536 distinct rows: codes of the rows, then the distinct rows.

- "grid": for three float32 columns: 16-bit codes, then an origin and a step for each chunk of 192 rows. The
  values are origin + code * step.

Values and codes are stored column by column. A column is stored as planes: the first byte of all rows, then
the second byte, and so on. Planes compress better, because similar bytes are next to each other.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Rows per chunk in the encoding "grid": the corners of 64 faces.
CHUNK = 192
# Number of values per column in the encoding "palette".
LEVELS = 256
# Maximum number of distinct rows in the encoding "rows".
_MAX_ROWS = 1 << 16
# Number of rows that are tested before the whole array. If an encoding cannot store an array, a test of the
# first rows usually shows this early.
_SAMPLE = 4096
_HIGHEST_CODE = 65535
# Number of bits of the mantissa of a float32.
_MANTISSA = 23


@dataclass(frozen=True)
class Stored:
    """A compressed array.

    Attributes
    ----------
    head : dict
        `type`, `shape`, `how`, `bytes` (before compression) and further keys of the encoding.
    data : bytes
        A zlib stream.
    """

    head: dict[str, Any]
    data: bytes


def store(array: NDArray[Any]) -> Stored:
    """Compress an array in the first encoding that can store it.

    `array` is float32, uint32 or uint8 and has one or two axes.
    """
    table = np.ascontiguousarray(array).reshape(len(array), -1)
    packed = None
    if table.dtype == np.float32 and table.size:
        packed = _as_rows(table) or _as_palette(table) or _as_grid(table)
    if packed is None:
        packed = _as_plain(table)
    extra, parts = packed
    raw = b"".join(parts)
    head = {"type": array.dtype.name, "shape": list(array.shape), **extra, "bytes": len(raw)}
    return Stored(head, zlib.compress(raw, 6))


def restore(head: Mapping[str, Any], data: bytes) -> NDArray[Any]:
    """Return the array that a head and a stream encode.

    Raises
    ------
    ValueError
        The stream has a wrong length, or the encoding is unknown.
    """
    # Limit the output, because a short stream can inflate to a huge size. In zlib, a limit of 0 means no
    # limit.
    raw = zlib.decompressobj().decompress(data, head["bytes"]) if head["bytes"] else b""
    if len(raw) != head["bytes"]:
        raise ValueError(f"the array has {len(raw)} bytes, not {head['bytes']}")
    shape = tuple(head["shape"])
    dtype, how = np.dtype(str(head["type"])), head["how"]
    rows = shape[0]
    columns = int(np.prod(shape[1:], dtype=np.int64))
    if how == "plain":
        table = _join(raw, rows, columns, dtype)
        if head.get("delta"):
            table = np.cumsum(table, axis=0, dtype=dtype)
    elif how == "palette":
        codes = _join(raw, rows, columns, np.dtype(np.uint8))
        values = np.frombuffer(raw, np.float32, offset=codes.nbytes).reshape(columns, LEVELS)
        table = np.take_along_axis(values.T, codes, axis=0)
    elif how == "rows":
        codes = _join(raw, rows, 1, np.dtype(str(head["codes"])))
        table = np.frombuffer(raw, np.float32, offset=codes.nbytes).reshape(-1, columns)[codes[:, 0]]
    elif how == "grid":
        codes = _join(raw, rows, columns, np.dtype(np.uint16))
        chunks = -(-rows // CHUNK)
        rest = np.frombuffer(raw, np.float32, offset=codes.nbytes)
        origins, steps = rest[: chunks * columns].reshape(chunks, columns), rest[chunks * columns :]
        chunk = np.arange(rows) // CHUNK
        table = origins[chunk] + codes.astype(np.float32) * steps[chunk, None]
    else:
        raise ValueError(f"unknown encoding {how!r}")
    return table.reshape(shape)


def _split(table: NDArray[Any]) -> bytes:
    """Return a table (rows, columns) as bytes, column by column, each column as byte planes."""
    rows, columns = table.shape
    size = table.dtype.itemsize
    little = np.ascontiguousarray(table.T.astype(table.dtype.newbyteorder("<"), copy=False))
    planes = little.view(np.uint8).reshape(columns, rows, size)
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).tobytes()


def _join(raw: bytes, rows: int, columns: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the table (rows, columns) from the bytes that `_split` returned."""
    count = rows * columns * dtype.itemsize
    planes = np.frombuffer(raw, np.uint8, count).reshape(columns, dtype.itemsize, rows)
    values = np.ascontiguousarray(planes.transpose(2, 0, 1)).view(dtype.newbyteorder("<"))
    return values.reshape(rows, columns).astype(dtype, copy=False)


def _as_plain(table: NDArray[Any]) -> tuple[dict[str, Any], list[bytes]]:
    """Encode a table as "plain". Return the keys for the head, and the parts of the stream."""
    if table.dtype != np.uint32:
        return {"how": "plain"}, [_split(table)]
    difference = np.diff(table, axis=0, prepend=np.zeros((1, table.shape[1]), np.uint32))
    return {"how": "plain", "delta": True}, [_split(difference)]


def _as_palette(table: NDArray[np.float32]) -> tuple[dict[str, Any], list[bytes]] | None:
    """Return the encoding "palette" of a table, or None if a column has too many distinct values."""
    bits = table.view(np.uint32)
    if len(np.unique(bits[:_SAMPLE, -1])) > LEVELS or len(table) < 2 * LEVELS:
        return None
    codes = np.zeros(table.shape, np.uint8)
    values = np.zeros((table.shape[1], LEVELS), np.uint32)
    for column in range(table.shape[1]):
        distinct, code = np.unique(bits[:, column], return_inverse=True)
        if len(distinct) > LEVELS:
            return None
        values[column, : len(distinct)] = distinct
        codes[:, column] = code
    return {"how": "palette"}, [_split(codes), values.tobytes()]


def _as_rows(table: NDArray[np.float32]) -> tuple[dict[str, Any], list[bytes]] | None:
    """Return the encoding "rows" of a table, or None if too many rows are distinct."""
    if table.shape[1] < 2 or len(table) < _SAMPLE:
        return None
    rows = table.view(np.dtype((np.void, 4 * table.shape[1])))[:, 0]
    most = min(_MAX_ROWS, len(rows) // 4)
    if len(np.unique(rows[: 2 * most])) > most:
        return None
    distinct, code = np.unique(rows, return_inverse=True)
    if len(distinct) > most:
        return None
    dtype = np.dtype(np.uint8 if len(distinct) <= LEVELS else np.uint16)
    return {"how": "rows", "codes": dtype.name}, [_split(code[:, None].astype(dtype)), distinct.tobytes()]


def find_exponents(table: NDArray[np.float32], codes: int) -> NDArray[np.int32]:
    """Return the exponent e of the grid step 2**e for each chunk of rows.

    The exponent is the smallest number that meets two conditions. First, `codes` steps together cover the
    range of values in the chunk. Second, float32 can represent every multiple of the step within this range
    exactly.
    """
    # Chunks (n, 192, columns); the last chunk is padded with its last row.
    chunks = -(-len(table) // CHUNK)
    padded = np.concatenate([table, np.repeat(table[-1:], chunks * CHUNK - len(table), axis=0)])
    parts = padded.reshape(chunks, -1, table.shape[1]).astype(np.float64)
    span = (parts.max(axis=1) - parts.min(axis=1)).max(axis=1)
    size = np.abs(parts).max(axis=(1, 2))
    # Lower bounds of the step: `span / codes`, and the float32 spacing of the largest value.
    fine = np.ceil(np.log2(np.maximum(span, 1e-30) / codes))
    exact = np.frexp(size)[1] - _MANTISSA - 1
    return np.asarray(np.maximum(np.maximum(fine, exact), -100), np.int32)


def _as_grid(table: NDArray[np.float32]) -> tuple[dict[str, Any], list[bytes]] | None:
    """Return the encoding "grid" of a table, or None if its values do not lie on a grid."""
    if table.shape[1] != 3 or not np.isfinite(table).all():
        return None
    if len(table) > 2 * _SAMPLE and _as_grid(table[: _SAMPLE // CHUNK * CHUNK]) is None:
        return None
    steps = np.exp2(find_exponents(table, _HIGHEST_CODE)).astype(np.float32)
    starts = np.arange(0, len(table), CHUNK)
    origins = np.minimum.reduceat(table, starts, axis=0)
    chunk = np.arange(len(table)) // CHUNK
    codes = np.rint((table.astype(np.float64) - origins[chunk]) / steps[chunk, None])
    if codes.max() > _HIGHEST_CODE:
        return None
    # Decode the table and compare the bit patterns.
    integers = codes.astype(np.uint16)
    restored = origins[chunk] + integers.astype(np.float32) * steps[chunk, None]
    if not np.array_equal(restored.view(np.uint32), table.view(np.uint32)):
        return None
    return {"how": "grid"}, [_split(integers), origins.tobytes(), steps.tobytes()]
