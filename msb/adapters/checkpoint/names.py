"""The names that the pickle of a checkpoint may use, and the meanings of these names.

A name in a checkpoint's pickle selects a function of this module. No other module is searched, so a file
cannot reach other code. Unknown names are rejected before any call.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.adapters.checkpoint.tensors import BFloat16Array, Refusal, Storages, StorageType, rebuild_tensor
from msb.errors import shorten

# Maximum number of characters that `_codecs.encode` accepts. Valid files use this function only for NumPy
# scalars of at most 8 bytes. Without a limit a file could exhaust the memory by encoding a long text many
# times.
MAX_ENCODED = 64


@dataclass(frozen=True)
class Function:
    """A name in the pickle that refers to a function.

    `apply` is called with the storages of the file and the arguments from the pickle.
    """

    name: str
    apply: Callable[[Storages, tuple[Any, ...]], Any]


@dataclass(frozen=True)
class ScalarType:
    """A `numpy.dtype` of little-endian numbers."""

    dtype: np.dtype[Any]

    def accepts_state(self, state: Any) -> bool:
        """Return whether `state` is the state that NumPy saves for a little-endian number type without
        fields."""
        # The state has the version and the byte order. Empty values for fields, sizes and flags follow
        # (numpy: `dtype.__reduce__`). Check the types first, because comparing arrays from the file is not
        # safe.
        if type(state) is not tuple or any(type(item) not in (int, str, type(None)) for item in state):
            return False
        return state in ((3, "<", None, None, None, -1, -1, 0), (3, "|", None, None, None, -1, -1, 0))


_SCALAR_TYPES = {
    name: ScalarType(np.dtype(f"<{name}"))
    for name in ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1")
}


def _ordered_dict(_: Storages, arguments: tuple[Any, ...]) -> dict[Any, Any]:
    if arguments:  # only Python 2 passes the items as arguments
        raise Refusal(
            "CHECKPOINT_HOSTILE", "an OrderedDict has arguments; only an empty OrderedDict is supported"
        )
    return {}


def _parameter(_: Storages, arguments: tuple[Any, ...]) -> Any:
    """Return the tensor of a Parameter. The other two arguments of a Parameter matter only for training."""
    if len(arguments) != 3 or not isinstance(arguments[0], np.ndarray | BFloat16Array):
        raise Refusal("CHECKPOINT_HOSTILE", "the first argument of a Parameter is not a tensor")
    return arguments[0]


def _encode(_: Storages, arguments: tuple[Any, ...]) -> bytes:
    """Return bytes. Pickle protocol 2 stores bytes as text, with a character for each byte."""
    if len(arguments) != 2 or any(type(item) is not str for item in arguments) or arguments[1] != "latin1":
        raise Refusal("CHECKPOINT_HOSTILE", "bytes must be stored as text that is encoded as latin1")
    text: str = arguments[0]
    if len(text) > MAX_ENCODED or any(ord(character) > 255 for character in text):
        message = (
            f"text in place of bytes must have at most {MAX_ENCODED} characters, all below U+0100; it has "
            f"{len(text)} characters"
        )
        raise Refusal("CHECKPOINT_HOSTILE", message)
    return text.encode("latin1")


def _scalar_type(_: Storages, arguments: tuple[Any, ...]) -> ScalarType:
    name = arguments[0] if len(arguments) == 3 else None
    if type(name) is not str or name not in _SCALAR_TYPES:
        text = f"the NumPy type {shorten(repr(name), 30) if type(name) is str else ''} is not a number type"
        raise Refusal("CHECKPOINT_FORM", text)
    return _SCALAR_TYPES[name]


def _scalar(_: Storages, arguments: tuple[Any, ...]) -> float | int | bool:
    if len(arguments) != 2 or type(arguments[0]) is not ScalarType or type(arguments[1]) is not bytes:
        raise Refusal("CHECKPOINT_FORM", "the arguments of a NumPy scalar are not a type and bytes")
    dtype, raw = arguments[0].dtype, arguments[1]
    if len(raw) != dtype.itemsize or (dtype == np.bool_ and raw > b"\x01"):
        raise Refusal("CHECKPOINT_FORM", f"a NumPy {dtype.name} has {len(raw)} bytes, or an invalid value")
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


# The meaning of each name in the pickle. A key is a pair (module, name), because two pairs joined by a dot
# could give equal text.
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

# Unsupported kinds of tensors by their names in `torch._utils`, with texts for the error message.
OTHER_TENSORS = {
    "_rebuild_tensor": "in the format before torch 0.4",
    "_rebuild_tensor_v3": "of a type with untyped storage (uint16, float8, ...)",
    "_rebuild_parameter_with_state": "with additional attributes",
    "_rebuild_sparse_tensor": "sparse",
    "_rebuild_sparse_csr_tensor": "sparse",
    "_rebuild_nested_tensor": "nested",
    "_rebuild_qtensor": "quantised",
    "_rebuild_meta_tensor_no_storage": "without data (on the meta device)",
    "_rebuild_wrapper_subclass": "of a subclass",
    "_rebuild_device_tensor_from_numpy": "in the format of another device",
    "_rebuild_device_tensor_from_cpu_tensor": "in the format of another device",
}


def find(module: str, name: str) -> Function | StorageType:
    """Return the meaning of a name in the pickle, or reject the name."""
    meaning = NAMES.get((module, name))
    if meaning is None and module == "torch._utils" and name in OTHER_TENSORS:
        raise Refusal("CHECKPOINT_FORM", f"a tensor is {OTHER_TENSORS[name]}; save it as a dense tensor")
    if meaning is None:
        text = (
            f"the pickle refers to {shorten(f'{module}.{name}')}; only tensors and plain values are supported"
        )
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if type(meaning) is StorageType and meaning.dtype is None:
        raise Refusal(
            "CHECKPOINT_FORM",
            f"a tensor stores its values in a {meaning.name}, which is not supported; convert the tensor "
            "first",
        )
    return meaning
