"""What a checkpoint holds, as JSON plus arrays: to compare two readers, and to keep what torch said."""

from typing import Any

import numpy as np

from msb.adapters.checkpoint import BFloat16Array


def describe(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return `value` as JSON in which every type and bit is told apart; its arrays are appended to a list."""
    if type(value) is dict:
        return ["dict", [[describe(key, arrays), describe(item, arrays)] for key, item in value.items()]]
    if type(value) in (list, tuple):
        return [type(value).__name__, [describe(item, arrays) for item in value]]
    if isinstance(value, BFloat16Array):
        return ["bfloat16", describe(value.to_float32(), arrays)]
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return ["array", len(arrays) - 1, value.dtype.name, list(value.shape)]
    if type(value) is float:
        return ["float", value.hex()]
    if type(value) is bytes:
        return ["bytes", value.hex()]
    assert value is None or type(value) in (str, int, bool), type(value)
    return [type(value).__name__, value]


def assert_same_arrays(found: list[np.ndarray], wanted: list[np.ndarray]) -> None:
    """Check that arrays agree bit for bit, NaN and negative zero included."""
    assert len(found) == len(wanted)
    for ours, theirs in zip(found, wanted, strict=True):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        assert ours.tobytes() == theirs.tobytes()
