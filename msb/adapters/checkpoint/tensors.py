"""Storages and tensors of a checkpoint as read-only NumPy views of the mapped file.

A tensor is a window of a storage (a flat array). The window has an offset, and a size and a stride for each
axis, all in elements. Python integers check the window without overflow before NumPy uses the numbers.
Sources for the format: pytorch/pytorch, `torch/_utils.py` (the arguments of a tensor) and
`torch/serialization.py` (persistent ids).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from msb.errors import shorten

# Maximum number of axes, the limit of NumPy. Tensors of models have at most 4 axes.
MAX_AXES = 32
# Maximum number of elements of a tensor. NumPy can overflow even for an empty tensor, so an axis of length 0
# counts as 1.
MAX_ELEMENTS = 1 << 48

_PLACEHOLDER = np.zeros(0, np.uint8)
_KEY = re.compile(r"[0-9]{1,20}\Z")


class Refusal(Exception):
    """An error in the checkpoint file. `read_checkpoint` converts this exception to a `CheckpointError`.

    Parameters
    ----------
    code, message : str
        The code and the message of the `CheckpointError`.
    at : str, optional
        The position in the file: "byte 12", or "data.pkl byte 12".
    """

    def __init__(self, code: str, message: str, *, at: str | None = None) -> None:
        super().__init__(code, message)
        self.code, self.message = code, message
        self.at = at


class Unfinished(Refusal):
    """The data end before the pickle is complete."""


@dataclass(frozen=True)
class StorageType:
    """A storage class of torch. `dtype` is None for unsupported types."""

    name: str
    dtype: np.dtype[Any] | None
    bfloat16: bool = False


@dataclass(frozen=True)
class Storage:
    """A storage of `count` elements. The bytes of the storage start at `offset` of the file."""

    key: str
    kind: StorageType
    count: int
    offset: int


@dataclass(frozen=True, eq=False)
class BFloat16Array:
    """A bfloat16 tensor: the upper halves of float32 numbers as uint16. NumPy has no bfloat16."""

    bits: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        return self.bits.shape

    def to_float32(self) -> np.ndarray:
        """Return a copy as float32; the conversion is exact."""
        wide = self.bits.astype(np.uint32) << np.uint32(16)
        return np.asarray(wide).view(np.float32)


class Extent(NamedTuple):
    """Offset and length, in bytes, of a storage in the file."""

    offset: int
    length: int


class Storages:
    """The storages of the file `view`, and the tensors that use them. `places` maps keys of storages to
    their positions."""

    def __init__(self, view: memoryview, places: Mapping[str, Extent]) -> None:
        self.view, self.places = view, places
        self.declared: dict[str, Storage] = {}

    def storage(self, reference: Any) -> Storage:
        """Return the storage that a persistent id names.

        The id is ``("storage", type, key, location, count)``, followed by None in files before torch 1.6.
        The location (``cuda:0``, ``cpu``) is the device of the training, and is ignored.
        """
        code = "CHECKPOINT_HOSTILE"
        if (
            type(reference) is not tuple
            or len(reference) not in (5, 6)
            or (reference[5:] and reference[5] is not None)
        ):
            raise Refusal(code, "a persistent id is not the tuple of 5 values of a storage")
        tag, kind, key, location, count = reference[:5]
        if type(tag) is not str or tag != "storage" or type(kind) is not StorageType:
            raise Refusal(code, "a persistent id does not refer to a storage")
        if type(key) is not str or not _KEY.match(key) or type(location) is not str:
            raise Refusal(code, "the key of a storage is not a number as text, or its location is not text")
        if type(count) is not int or count < 0:
            raise Refusal(code, f"storage {key} does not state its number of elements")
        known = self.declared.get(key)
        if known is None:
            known = self.declared[key] = Storage(key, kind, count, self.locate(key, kind, count))
        elif (known.kind, known.count) != (kind, count):
            first, second = f"{known.count} x {known.kind.name}", f"{_count(count)} x {kind.name}"
            text = f"storage {key} is declared both as {first} and as {second}"
            raise Refusal("CHECKPOINT_HOSTILE", text)
        return known

    def locate(self, key: str, kind: StorageType, count: int) -> int:
        """Return the start of a storage in the file, after checking its size and values."""
        if key not in self.places:
            raise Refusal("CHECKPOINT_DAMAGED", f"data/{key} is missing in the archive")
        assert kind.dtype is not None  # `names.find` rejects other types
        offset, length = self.places[key]
        wanted = count * kind.dtype.itemsize
        if length != wanted:
            text = f"storage {key} has {length} bytes, but the pickle declares {_count(count)} x {kind.name}"
            raise Refusal("CHECKPOINT_DAMAGED", text)
        if kind.dtype == np.bool_ and length and np.frombuffer(self.view, np.uint8, length, offset).max() > 1:
            raise Refusal("CHECKPOINT_DAMAGED", f"storage {key} has booleans other than 0 and 1")
        return offset

    def tensor(self, storage: Storage, offset: int, window: Window) -> Any:
        """Return the view of `storage` that begins at element `offset`."""
        dtype = storage.kind.dtype
        assert dtype is not None
        array: np.ndarray = np.ndarray(
            window.size,
            dtype,
            self.view,
            storage.offset + offset * dtype.itemsize,
            tuple(step * dtype.itemsize for step in window.stride),
        )
        return BFloat16Array(array) if storage.kind.bfloat16 else array


class DeclaredStorages(Storages):
    """Collects the storages of a file before their positions are known. All tensors are empty."""

    def __init__(self) -> None:
        super().__init__(memoryview(b""), {})

    def locate(self, key: str, kind: StorageType, count: int) -> int:
        return 0

    def tensor(self, storage: Storage, offset: int, window: Window) -> Any:
        return _PLACEHOLDER


class Window(NamedTuple):
    """Size and stride of a tensor in elements."""

    size: tuple[int, ...]
    stride: tuple[int, ...]


def rebuild_tensor(storages: Storages, arguments: tuple[Any, ...]) -> Any:
    """Return the tensor for a call of ``torch._utils._rebuild_tensor_v2``.

    The arguments of the call are storage, offset, size, stride, requires_grad and hooks. The last two
    arguments of the call matter only for training.
    """
    code = "CHECKPOINT_HOSTILE"
    if len(arguments) != 6:
        raise Refusal(code, f"a tensor has {len(arguments)} arguments instead of 6")
    storage, offset, size, stride = arguments[:4]
    if type(storage) is not Storage:
        raise Refusal(code, "the first argument of a tensor is not a storage")
    if not (_is_integers(size) and _is_integers(stride) and type(offset) is int):
        raise Refusal(code, f"size, stride or offset of a tensor in storage {storage.key} are not integers")
    window = _check_window(storage, offset, size, stride)
    return storages.tensor(storage, offset if math.prod(size) else 0, window)


def _is_integers(value: Any) -> bool:
    return type(value) is tuple and all(type(item) is int for item in value)


def _check_window(storage: Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...]) -> Window:
    """Check that a tensor's window is inside its storage; return the window with strides that NumPy
    accepts."""
    where = f"a tensor in storage {storage.key}"
    if len(size) > MAX_AXES or any(n < 0 for n in size) or math.prod(n or 1 for n in size) > MAX_ELEMENTS:
        text = f"{where} has {len(size)} axes of {_list(size)}; at most {MAX_AXES} axes are allowed"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if len(stride) != len(size) or any(step < 0 for step in stride):
        text = f"{where} of size {_list(size)} has the strides {_list(stride)}"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    # Index of the last element of the tensor in the storage.
    elements = math.prod(size)
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True)) if elements else offset
    if offset < 0 or last > storage.count or (elements and last == storage.count):
        text = f"{where} ends at element {_count(last)}; the storage has {_count(storage.count)}"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if elements > storage.count:
        text = f"{where} has {_count(elements)} elements; the storage has {_count(storage.count)}"
        raise Refusal("CHECKPOINT_FORM", text)
    # The stride of an axis of length 1, or of an empty tensor, is arbitrary, and can be too large for NumPy.
    return Window(
        size, tuple(step if n > 1 and elements else 1 for n, step in zip(size, stride, strict=True))
    )


def _count(number: int) -> str:
    """Return a number from the file as text; long numbers are shortened."""
    return shorten(str(number), 24)


def _list(numbers: tuple[int, ...]) -> str:
    return shorten(str(numbers[: MAX_AXES + 1]), 60)
