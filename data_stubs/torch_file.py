"""Write a dictionary of tensors in the format of `torch.save` without torch, for stubs, tests and benchmarks.

The file is a ZIP of stored members on 64-byte boundaries: `data.pkl` (protocol 2), and one raw storage per
tensor (pytorch/pytorch: torch/serialization.py, caffe2/serialize). Tensors are written in pieces, so a tensor
may be a memory map.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_STORAGES = {"<f4": "FloatStorage", "<i4": "IntStorage", "<i8": "LongStorage", "<f8": "DoubleStorage"}
_STORAGES |= {"<f2": "HalfStorage", "|u1": "ByteStorage", "|b1": "BoolStorage"}
_PIECE = 1 << 24
_DATE = (1980, 1, 1, 0, 0, 0)
_ORDERED_DICT = b"ccollections\nOrderedDict\n)R"


def write_torch(file: Path | BinaryIO, value: Any, root: str = "archive") -> None:
    """Write a torch file; `value` is made of dictionaries, tuples, lists, tensors, numbers, text, None."""
    storages: list[NDArray[Any]] = []
    pickle = b"\x80\x02" + _value(value, storages) + b"."
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        _member(archive, f"{root}/data.pkl", [pickle])
        _member(archive, f"{root}/byteorder", [b"little"])
        for number, array in enumerate(storages):
            flat = array.reshape(-1).view(np.uint8)
            pieces = [flat[start : start + _PIECE] for start in range(0, len(flat), _PIECE)]
            _member(archive, f"{root}/data/{number}", pieces)
        _member(archive, f"{root}/version", [b"3\n"])


def _member(archive: zipfile.ZipFile, name: str, pieces: list[Any]) -> None:
    info = zipfile.ZipInfo(name, _DATE)
    size = sum(len(piece) for piece in pieces)
    large = size >= 1 << 30
    assert archive.fp is not None
    start = archive.fp.tell() + 30 + len(name) + 4 + (20 if large else 0)
    padding = -start % 64
    info.extra = struct.pack("<2H", 0x4246, padding) + b"Z" * padding
    info.file_size = size
    with archive.open(info, "w", force_zip64=large) as member:
        for piece in pieces:
            member.write(piece)


def _text(value: str) -> bytes:
    raw = value.encode()
    return b"X" + struct.pack("<I", len(raw)) + raw


def _integer(value: int) -> bytes:
    if -(1 << 31) <= value < 1 << 31:
        return b"J" + struct.pack("<i", value)
    return b"\x8a\x08" + struct.pack("<q", value)


def _value(value: Any, storages: list[NDArray[Any]]) -> bytes:
    if value is None or isinstance(value, bool):
        return {None: b"N", True: b"\x88", False: b"\x89"}[value]
    if isinstance(value, int):
        return _integer(value)
    if isinstance(value, float):
        return b"G" + struct.pack(">d", value)
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, dict):
        return b"}(" + b"".join(_text(k) + _value(v, storages) for k, v in value.items()) + b"u"
    if isinstance(value, list | tuple):
        items = b"".join(_value(item, storages) for item in value)
        return b"(" + items + b"t" if isinstance(value, tuple) else b"](" + items + b"e"
    array = np.asarray(value, order="C")
    storages.append(array)
    kind = _STORAGES[array.dtype.newbyteorder("<").str]
    reference = _text("storage") + f"ctorch\n{kind}\n".encode() + _text(str(len(storages) - 1))
    reference += _text("cuda:0") + _integer(array.size)
    strides = [step // array.itemsize for step in array.strides]
    rows = [b"(" + b"".join(map(_integer, numbers)) + b"t" for numbers in (array.shape, strides)]
    tensor = b"ctorch._utils\n_rebuild_tensor_v2\n((" + reference + b"tQ" + _integer(0) + rows[0] + rows[1]
    return tensor + b"\x89" + _ORDERED_DICT + b"tR"
