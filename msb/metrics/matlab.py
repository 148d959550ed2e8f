"""Read numeric arrays from untrusted MATLAB 5 files.

`scipy.io.loadmat` is not used: in SciPy 1.17 an invalid type number still crashes the process with a
segmentation fault.

Source: The MathWorks, MAT-File Format, chapter 1, "Level 5 MAT-Files".
"""

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
# Class numbers of numeric arrays. Smaller numbers are the classes of cells, structures, text and sparse
# arrays.
_NUMERIC = range(6, 16)
_COMPLEX = 0x0800
# Maximum number of bytes before the values of an array: flags, up to 32 axes, and a name of up to 63
# characters.
_HEAD = 1024
_ENDS = "the file ends within a variable"


@dataclass(frozen=True)
class Variable:
    """An array in a MATLAB file. The values of the array are not read yet."""

    name: str
    # Values as stored, without a check.
    shape: tuple[int, ...]
    _body: memoryview
    _compressed: bool
    _order: str
    _numeric: bool
    _start: int

    def read(self) -> NDArray[Any]:
        """Return the values as a read-only array in their stored type.

        MATLAB stores integers in smaller types.
        """
        if not self._numeric or min(self.shape) < 0:
            raise ValueError(f"{self.name} does not hold real numbers")
        count = math.prod(self.shape)
        head = _unpack(self._body, self._compressed, self._start + 8)
        kind, start, size, _ = _read_element(head, self._start, self._order)
        if kind not in _TYPES:
            raise ValueError(f"{self.name} has the unknown type {kind}")
        dtype = np.dtype(self._order + _TYPES[kind])
        if size != count * dtype.itemsize:
            raise ValueError(f"{self.name} has {size} bytes for {count} numbers of {dtype.itemsize}")
        content = _unpack(self._body, self._compressed, start + size)
        if len(content) < start + size:
            raise ValueError(_ENDS)
        return np.frombuffer(content, dtype, count, start).reshape(self.shape, order="F")


def find_variables(data: bytes) -> dict[str, Variable]:
    """Return the arrays of the MATLAB 5 file `data` by name."""
    order = {b"IM": "<", b"MI": ">"}.get(data[_HEADER - 2 : _HEADER])
    if order is None:
        raise ValueError("the header of a MATLAB 5 file is missing")
    if struct.unpack_from(order + "H", data, _HEADER - 4) != (0x0100,):
        raise ValueError("unsupported version, such as 7.3 (HDF5); save the file with -v7")
    variables: dict[str, Variable] = {}
    view, at = memoryview(data), _HEADER
    while at < len(data):
        kind, start, size, _ = _read_element(view, at, order)
        at = start + size
        if at > len(data):
            raise ValueError(_ENDS)
        if kind in (_MATRIX, _COMPRESSED):
            variable = _describe(view[start:at], kind == _COMPRESSED, order)
            variables.setdefault(variable.name, variable)
    return variables


def _describe(body: memoryview, compressed: bool, order: str) -> Variable:
    head = _unpack(body, compressed, _HEAD)
    at = 8 if compressed else 0  # if the data are compressed, skip the tag of the matrix
    _, start, _, at = _read_element(head, at, order)
    flags = _read_numbers(head, start, 1, order)[0]
    _, start, size, at = _read_element(head, at, order)
    shape = _read_numbers(head, start, size // 4, order)
    _, start, size, at = _read_element(head, at, order)
    name = bytes(head[start : start + size]).decode("latin-1")
    numeric = flags & 0xFF in _NUMERIC and not flags & _COMPLEX and len(shape) > 0
    return Variable(name, shape, body, compressed, order, numeric, at)


def _read_element(data: bytes | memoryview, at: int, order: str) -> tuple[int, int, int, int]:
    """Return type, start and length of the element at the position `at`.

    Also return the position of the next element.
    """
    word = _read_numbers(data, at, 1, order, "I")[0]
    if word >> 16:  # small format: the upper half of the word is the length, and the data follow directly
        return word & 0xFFFF, at + 4, word >> 16, at + 8
    size = _read_numbers(data, at + 4, 1, order, "I")[0]
    return word, at + 8, size, at + 8 + size + -size % 8


def _read_numbers(
    data: bytes | memoryview, at: int, count: int, order: str, kind: str = "i"
) -> tuple[int, ...]:
    if at + 4 * count > len(data):
        raise ValueError(_ENDS)
    return struct.unpack_from(f"{order}{count}{kind}", data, at)


def _unpack(body: memoryview, compressed: bool, most: int) -> bytes | memoryview:
    """Return the first `most` bytes of a variable. If necessary, decompress them."""
    return zlib.decompressobj().decompress(body, most) if compressed else body[:most]
