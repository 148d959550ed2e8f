"""Storages and tensors of a checkpoint as read-only NumPy views on the mapped file.

A tensor is a window into a storage: an offset, a size and a stride per axis, all in elements. Everything is
checked with Python integers, which do not wrap, before NumPy sees it. Sources for what torch writes:
pytorch/pytorch, `torch/_utils.py` (the arguments of a tensor) and `torch/serialization.py` (persistent ids).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from msb.errors import shorten

# Most axes of a tensor, which every supported NumPy can hold; model tensors have at most 4.
MAX_AXES = 32
# Most elements of a tensor. An axis of length 0 counts as 1, because the sizes of an empty tensor must not
# overflow in NumPy either.
MAX_ELEMENTS = 1 << 48

_PLACEHOLDER = np.zeros(0, np.uint8)
_KEY = re.compile(r"[0-9]{1,20}\Z")


class Refusal(Exception):
    """A reason to refuse the file; `read_checkpoint` makes a `CheckpointError` of it.

    Parameters
    ----------
    code, message : str
        The code and the message of the `CheckpointError`.
    at : str, optional
        The place in the file: "byte 12", or "data.pkl byte 12".
    """

    def __init__(self, code: str, message: str, *, at: str | None = None) -> None:
        super().__init__(code, message)
        self.code, self.message = code, message
        self.at = at


class Unfinished(Refusal):
    """The pickle goes on behind the bytes there are."""


@dataclass(frozen=True)
class StorageType:
    """One of torch's storage classes. `dtype` is None for a type that is not read."""

    name: str
    dtype: np.dtype[Any] | None
    bfloat16: bool = False


@dataclass(frozen=True)
class Storage:
    """A run of `count` elements; their bytes start at `offset` of the file."""

    key: str
    kind: StorageType
    count: int
    offset: int


@dataclass(frozen=True, eq=False)
class BFloat16Array:
    """A bfloat16 tensor, which NumPy has no type for: the upper halves of float32 numbers, as uint16."""

    bits: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        return self.bits.shape

    def to_float32(self) -> np.ndarray:
        """Return the numbers as float32, which is exact; this copies."""
        wide = self.bits.astype(np.uint32) << np.uint32(16)
        return np.asarray(wide).view(np.float32)


class Extent(NamedTuple):
    """Where the bytes of a storage are in the file."""

    offset: int
    length: int


class Storages:
    """The storages of the file `view`, which lie at `places` by key, and the tensors on them."""

    def __init__(self, view: memoryview, places: Mapping[str, Extent]) -> None:
        self.view, self.places = view, places
        self.declared: dict[str, Storage] = {}

    def storage(self, reference: Any) -> Storage:
        """Return the storage that a persistent id refers to.

        It is ``("storage", type, key, location, count)``, with None behind it in files of before torch 1.6.
        The location (``cuda:0``, ``cpu``) only says where the storage was when it was saved.
        """
        code = "CHECKPOINT_HOSTILE"
        if (
            type(reference) is not tuple
            or len(reference) not in (5, 6)
            or (reference[5:] and reference[5] is not None)
        ):
            raise Refusal(code, "a persistent id is not the tuple of 5 that stands for a storage")
        tag, kind, key, location, count = reference[:5]
        if type(tag) is not str or tag != "storage" or type(kind) is not StorageType:
            raise Refusal(code, "a persistent id refers to something else than a storage")
        if type(key) is not str or not _KEY.match(key) or type(location) is not str:
            raise Refusal(code, "the key of a storage is not a number in text, or its location is no text")
        if type(count) is not int or count < 0:
            raise Refusal(code, f"storage {key} does not say how many elements it has")
        known = self.declared.get(key)
        if known is None:
            known = self.declared[key] = Storage(key, kind, count, self.locate(key, kind, count))
        elif (known.kind, known.count) != (kind, count):
            text = (
                f"storage {key} is {known.count} x {known.kind.name}, elsewhere {_count(count)} x {kind.name}"
            )
            raise Refusal("CHECKPOINT_HOSTILE", text)
        return known

    def locate(self, key: str, kind: StorageType, count: int) -> int:
        """Return where the storage starts in the file, its size and values checked."""
        if key not in self.places:
            raise Refusal("CHECKPOINT_DAMAGED", f"the archive has no data/{key}")
        assert kind.dtype is not None  # the machine refuses the names of other types
        offset, length = self.places[key]
        wanted = count * kind.dtype.itemsize
        if length != wanted:
            text = f"storage {key} has {length} bytes; the pickle says {_count(count)} x {kind.name}"
            raise Refusal("CHECKPOINT_DAMAGED", text)
        if kind.dtype == np.bool_ and length and np.frombuffer(self.view, np.uint8, length, offset).max() > 1:
            raise Refusal("CHECKPOINT_DAMAGED", f"storage {key} holds booleans other than 0 and 1")
        return offset

    def tensor(self, storage: Storage, offset: int, window: Window) -> Any:
        """Return the view on `storage` from element `offset` on."""
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
    """A stand-in for `Storages` before their places are known; it collects them and makes no tensors."""

    def __init__(self) -> None:
        super().__init__(memoryview(b""), {})

    def locate(self, key: str, kind: StorageType, count: int) -> int:
        return 0

    def tensor(self, storage: Storage, offset: int, window: Window) -> Any:
        return _PLACEHOLDER


class Window(NamedTuple):
    """Size and stride of a tensor, in elements."""

    size: tuple[int, ...]
    stride: tuple[int, ...]


def rebuild_tensor(storages: Storages, arguments: tuple[Any, ...]) -> Any:
    """Return the tensor that ``torch._utils._rebuild_tensor_v2`` would be called for.

    The arguments are storage, offset, size, stride, requires_grad and hooks; the last two matter only for
    training.
    """
    code = "CHECKPOINT_HOSTILE"
    if len(arguments) != 6:
        raise Refusal(code, f"a tensor is made from {len(arguments)} values, not from 6")
    storage, offset, size, stride = arguments[:4]
    if type(storage) is not Storage:
        raise Refusal(code, "a tensor is made from something else than a storage")
    if not (_is_integers(size) and _is_integers(stride) and type(offset) is int):
        raise Refusal(code, f"size, stride or offset of a tensor on storage {storage.key} are not integers")
    window = _checked_window(storage, offset, size, stride)
    return storages.tensor(storage, offset if math.prod(size) else 0, window)


def _is_integers(value: Any) -> bool:
    return type(value) is tuple and all(type(item) is int for item in value)


def _checked_window(storage: Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...]) -> Window:
    """Check that the window lies in the storage; return it with strides that NumPy takes."""
    where = f"a tensor on storage {storage.key}"
    if len(size) > MAX_AXES or any(n < 0 for n in size) or math.prod(n or 1 for n in size) > MAX_ELEMENTS:
        text = f"{where} has {len(size)} axes of {_list(size)}; at most {MAX_AXES} axes, none negative"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if len(stride) != len(size) or any(step < 0 for step in stride):
        text = f"{where} of size {_list(size)} has the strides {_list(stride)}"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    elements = math.prod(size)
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True)) if elements else offset
    if offset < 0 or last > storage.count or (elements and last == storage.count):
        text = f"{where} ends at element {_count(last)}; the storage has {_count(storage.count)}"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if elements > storage.count:
        text = f"{where} has {_count(elements)} elements; the storage has {_count(storage.count)}"
        raise Refusal("CHECKPOINT_FORM", text)
    # The stride along an axis of length 1 (or of an empty tensor) is arbitrary and may not even fit.
    return Window(
        size, tuple(step if n > 1 and elements else 1 for n, step in zip(size, stride, strict=True))
    )


def _count(number: int) -> str:
    """Return a count from the file as text of bounded length."""
    return shorten(str(number), 24)


def _list(numbers: tuple[int, ...]) -> str:
    return shorten(str(numbers[: MAX_AXES + 1]), 60)
