"""Arrays as they lie in a page, and back: bit for bit, in as few bytes as their values allow.

An array becomes a head (JSON) and a zlib stream, which a browser inflates itself; web/store.js reads both.
`how` says what the stream holds:

- "plain": the values; with `delta` (integers) the differences from row to row, modulo 2^32.
- "palette": for each column codes of its at most 256 different values; then the values, 256 a column.
- "rows": codes of the at most 65,536 different rows; then these rows.
- "grid": codes of 16 bits for three columns of float32: p = origin + code step, by chunks of 192 rows; then
  origins and steps.

Values and codes lie column by column, and of each column all first bytes, then all second bytes: equal bytes
side by side compress better.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Rows of a chunk of "grid": the corners of 64 faces.
CHUNK = 192
# Values of a column of "palette".
LEVELS = 256
_MOST_ROWS = 1 << 16
_SAMPLE = 4096
_HIGHEST_CODE = 65535
_MANTISSA = 23


@dataclass(frozen=True)
class Stored:
    """An array as it lies in a page.

    Attributes
    ----------
    head : dict
        `type`, `shape`, `how`, `bytes` (before compression) and what `how` needs.
    data : bytes
        A zlib stream.
    """

    head: dict[str, Any]
    data: bytes


def store(array: NDArray[Any]) -> Stored:
    """Return `array`, float32, uint32 or uint8 with one or two axes, in a small form that fits."""
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
    """Return the array of a head and a stream."""
    # A stream of zeros must not fill the memory; to zlib 0 stands for no limit, and less than 0 is wrong.
    raw = zlib.decompressobj().decompress(data, head["bytes"]) if head["bytes"] else b""
    if len(raw) != head["bytes"]:
        raise ValueError(f"an array of {head['bytes']} bytes has {len(raw)}")
    shape = tuple(head["shape"])
    dtype, how = np.dtype(str(head["type"])), head["how"]
    rows = shape[0]
    columns = int(np.prod(shape[1:], dtype=np.int64))
    if how == "plain":
        table = _joined(raw, rows, columns, dtype)
        if head.get("delta"):
            table = np.cumsum(table, axis=0, dtype=dtype)
    elif how == "palette":
        codes = _joined(raw, rows, columns, np.dtype(np.uint8))
        values = np.frombuffer(raw, np.float32, offset=codes.nbytes).reshape(columns, LEVELS)
        table = np.take_along_axis(values.T, codes, axis=0)
    elif how == "rows":
        codes = _joined(raw, rows, 1, np.dtype(str(head["codes"])))
        table = np.frombuffer(raw, np.float32, offset=codes.nbytes).reshape(-1, columns)[codes[:, 0]]
    elif how == "grid":
        codes = _joined(raw, rows, columns, np.dtype(np.uint16))
        chunks = -(-rows // CHUNK)
        rest = np.frombuffer(raw, np.float32, offset=codes.nbytes)
        origins, steps = rest[: chunks * columns].reshape(chunks, columns), rest[chunks * columns :]
        chunk = np.arange(rows) // CHUNK
        table = origins[chunk] + codes.astype(np.float32) * steps[chunk, None]
    else:
        raise ValueError(f"arrays are not stored as {how!r}")
    return table.reshape(shape)


def _split(table: NDArray[Any]) -> bytes:
    """Return columns, of each the first bytes of all rows, then the second ones, ..."""
    rows, columns = table.shape
    size = table.dtype.itemsize
    little = np.ascontiguousarray(table.T.astype(table.dtype.newbyteorder("<"), copy=False))
    planes = little.view(np.uint8).reshape(columns, rows, size)
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).tobytes()


def _joined(raw: bytes, rows: int, columns: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    count = rows * columns * dtype.itemsize
    planes = np.frombuffer(raw, np.uint8, count).reshape(columns, dtype.itemsize, rows)
    values = np.ascontiguousarray(planes.transpose(2, 0, 1)).view(dtype.newbyteorder("<"))
    return values.reshape(rows, columns).astype(dtype, copy=False)


def _as_plain(table: NDArray[Any]) -> tuple[dict[str, Any], list[bytes]]:
    if table.dtype != np.uint32:
        return {"how": "plain"}, [_split(table)]
    difference = np.diff(table, axis=0, prepend=np.zeros((1, table.shape[1]), np.uint32))
    return {"how": "plain", "delta": True}, [_split(difference)]


def _as_palette(table: NDArray[np.float32]) -> tuple[dict[str, Any], list[bytes]] | None:
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
    if table.shape[1] < 2 or len(table) < _SAMPLE:
        return None
    rows = table.view(np.dtype((np.void, 4 * table.shape[1])))[:, 0]
    most = min(_MOST_ROWS, len(rows) // 4)
    if len(np.unique(rows[: 2 * most])) > most:
        return None
    distinct, code = np.unique(rows, return_inverse=True)
    if len(distinct) > most:
        return None
    dtype = np.dtype(np.uint8 if len(distinct) <= LEVELS else np.uint16)
    return {"how": "rows", "codes": dtype.name}, [_split(code[:, None].astype(dtype)), distinct.tobytes()]


def exponents(table: NDArray[np.float32], codes: int) -> NDArray[np.int32]:
    """Return for each chunk of rows the exponent of two of the finest step of which `codes` span its values.

    At this step every multiple within the chunk is a float32.
    """
    chunks = -(-len(table) // CHUNK)
    padded = np.concatenate([table, np.repeat(table[-1:], chunks * CHUNK - len(table), axis=0)])
    parts = padded.reshape(chunks, -1, table.shape[1]).astype(np.float64)
    span = (parts.max(axis=1) - parts.min(axis=1)).max(axis=1)
    size = np.abs(parts).max(axis=(1, 2))
    fine = np.ceil(np.log2(np.maximum(span, 1e-30) / codes))
    exact = np.frexp(size)[1] - _MANTISSA - 1
    return np.asarray(np.maximum(np.maximum(fine, exact), -100), np.int32)


def _as_grid(table: NDArray[np.float32]) -> tuple[dict[str, Any], list[bytes]] | None:
    """Return values that are multiples of a power of two, at most 65,535 of it apart in a chunk."""
    if table.shape[1] != 3 or not np.isfinite(table).all():
        return None
    if len(table) > 2 * _SAMPLE and _as_grid(table[: _SAMPLE // CHUNK * CHUNK]) is None:
        return None
    steps = np.exp2(exponents(table, _HIGHEST_CODE)).astype(np.float32)
    starts = np.arange(0, len(table), CHUNK)
    origins = np.minimum.reduceat(table, starts, axis=0)
    chunk = np.arange(len(table)) // CHUNK
    codes = np.rint((table.astype(np.float64) - origins[chunk]) / steps[chunk, None])
    if codes.max() > _HIGHEST_CODE:
        return None
    whole = codes.astype(np.uint16)
    back = origins[chunk] + whole.astype(np.float32) * steps[chunk, None]
    if not np.array_equal(back.view(np.uint32), table.view(np.uint32)):
        return None
    return {"how": "grid"}, [_split(whole), origins.tobytes(), steps.tobytes()]
