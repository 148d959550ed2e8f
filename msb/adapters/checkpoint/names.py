"""The closed list of names a checkpoint's pickle may use, and what each stands for here.

A name in the file selects one of our own functions, which work on inert records. Nothing is looked up in a
module, so no name, however spelt, can reach code: a name outside the list is refused before any call.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.adapters.checkpoint.tensors import BFloat16Array, Refusal, Storages, StorageType, rebuild_tensor
from msb.errors import shorten

# Most characters that `_codecs.encode` takes; it only ever carries a NumPy scalar, of at most 8 bytes.
#
# Longer text could be sent through it again and again, with a copy each time.
MAX_ENCODED = 64


@dataclass(frozen=True)
class Function:
    """A name that stands for a call; `apply` gets the file's storages and the arguments."""

    name: str
    apply: Callable[[Storages, tuple[Any, ...]], Any]


@dataclass(frozen=True)
class ScalarType:
    """A `numpy.dtype` of numbers, always little-endian."""

    dtype: np.dtype[Any]

    def accepts_state(self, state: Any) -> bool:
        """Return whether `state` is what NumPy saves for a little-endian number without fields."""
        # Version, byte order, then nothing about fields, sizes or flags (numpy: `dtype.__reduce__`). Types
        # first: arrays and other things from the file may not be compared.
        if type(state) is not tuple or any(type(item) not in (int, str, type(None)) for item in state):
            return False
        return state in ((3, "<", None, None, None, -1, -1, 0), (3, "|", None, None, None, -1, -1, 0))


_SCALAR_TYPES = {
    name: ScalarType(np.dtype(f"<{name}"))
    for name in ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1")
}


def _ordered_dict(_: Storages, arguments: tuple[Any, ...]) -> dict[Any, Any]:
    if arguments:  # Python 2 gave the items here; Python 3 adds them one by one
        raise Refusal("CHECKPOINT_HOSTILE", "an OrderedDict is made with arguments; only an empty one is")
    return {}


def _parameter(_: Storages, arguments: tuple[Any, ...]) -> Any:
    """A Parameter is its tensor; the other two arguments are about training."""
    if len(arguments) != 3 or not isinstance(arguments[0], np.ndarray | BFloat16Array):
        raise Refusal("CHECKPOINT_HOSTILE", "a Parameter is made from something else than a tensor")
    return arguments[0]


def _encode(_: Storages, arguments: tuple[Any, ...]) -> bytes:
    """Bytes as protocol 2 has to write them: text in which each character is a byte."""
    if len(arguments) != 2 or any(type(item) is not str for item in arguments) or arguments[1] != "latin1":
        raise Refusal("CHECKPOINT_HOSTILE", "only text encoded as latin1 stands for bytes")
    text: str = arguments[0]
    if len(text) > MAX_ENCODED or any(ord(character) > 255 for character in text):
        message = f"bytes in text are {len(text)} long or not bytes; at most {MAX_ENCODED} are taken"
        raise Refusal("CHECKPOINT_HOSTILE", message)
    return text.encode("latin1")


def _scalar_type(_: Storages, arguments: tuple[Any, ...]) -> ScalarType:
    name = arguments[0] if len(arguments) == 3 else None
    if type(name) is not str or name not in _SCALAR_TYPES:
        text = f"the NumPy type {shorten(repr(name), 30) if type(name) is str else ''} is not a plain number"
        raise Refusal("CHECKPOINT_FORM", text)
    return _SCALAR_TYPES[name]


def _scalar(_: Storages, arguments: tuple[Any, ...]) -> float | int | bool:
    if len(arguments) != 2 or type(arguments[0]) is not ScalarType or type(arguments[1]) is not bytes:
        raise Refusal("CHECKPOINT_FORM", "a NumPy scalar is not made from a type and bytes")
    dtype, raw = arguments[0].dtype, arguments[1]
    if len(raw) != dtype.itemsize or (dtype == np.bool_ and raw > b"\x01"):
        raise Refusal("CHECKPOINT_FORM", f"a NumPy {dtype.name} has {len(raw)} bytes, or odd ones")
    value: float | int | bool = np.frombuffer(raw, dtype)[0].item()
    return value


def _storage_types() -> dict[tuple[str, str], StorageType]:
    read = {
        "Double": "<f8",
        "Float": "<f4",
        "Half": "<f2",
        "Long": "<i8",
        "Int": "<i4",
        "Short": "<i2",
        "Char": "|i1",
        "Byte": "|u1",
        "Bool": "|b1",
    }
    types = [StorageType(f"{name}Storage", np.dtype(code)) for name, code in read.items()]
    types.append(StorageType("BFloat16Storage", np.dtype("<u2"), bfloat16=True))
    others = ("ComplexFloat", "ComplexDouble", "QInt8", "QUInt8", "QInt32", "QUInt4x2", "QUInt2x4")
    types += [StorageType(f"{name}Storage", None) for name in others]
    return {("torch", kind.name): kind for kind in types}


# (module, name) -> what it stands for. Joined by a dot, different pairs would be the same text.
NAMES: dict[tuple[str, str], Function | StorageType] = {
    **_storage_types(),
    ("torch.storage", "UntypedStorage"): StorageType("UntypedStorage", None),
    ("torch._utils", "_rebuild_tensor_v2"): Function("_rebuild_tensor_v2", rebuild_tensor),
    ("torch._utils", "_rebuild_parameter"): Function("_rebuild_parameter", _parameter),
    ("collections", "OrderedDict"): Function("OrderedDict", _ordered_dict),
    ("numpy", "dtype"): Function("dtype", _scalar_type),
    ("numpy.core.multiarray", "scalar"): Function("scalar", _scalar),  # NumPy 1
    ("numpy._core.multiarray", "scalar"): Function("scalar", _scalar),  # NumPy 2
    ("_codecs", "encode"): Function("encode", _encode),
}

# Names in `torch._utils` of kinds of tensors that are not read; a message of its own says so.
OTHER_TENSORS = {
    "_rebuild_tensor": "of before torch 0.4",
    "_rebuild_tensor_v3": "of a type with untyped storage (uint16, float8, ...)",
    "_rebuild_parameter_with_state": "with attributes of its own",
    "_rebuild_sparse_tensor": "sparse",
    "_rebuild_sparse_csr_tensor": "sparse",
    "_rebuild_nested_tensor": "nested",
    "_rebuild_qtensor": "quantised",
    "_rebuild_meta_tensor_no_storage": "without data (on the meta device)",
    "_rebuild_wrapper_subclass": "of a subclass",
    "_rebuild_device_tensor_from_numpy": "in the form of a foreign device",
    "_rebuild_device_tensor_from_cpu_tensor": "in the form of a foreign device",
}


def find(module: str, name: str) -> Function | StorageType:
    """Return what a name in the pickle stands for."""
    meaning = NAMES.get((module, name))
    if meaning is None and module == "torch._utils" and name in OTHER_TENSORS:
        raise Refusal("CHECKPOINT_FORM", f"a tensor is {OTHER_TENSORS[name]}; save it as a dense one")
    if meaning is None:
        text = f"it asks for {shorten(f'{module}.{name}')}; nothing but tensors and plain values is read"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if type(meaning) is StorageType and meaning.dtype is None:
        raise Refusal("CHECKPOINT_FORM", f"a tensor keeps its values in {meaning.name}; convert it first")
    return meaning
