"""Describe the content of a checkpoint as JSON and arrays.

Tests store expected values in this form, and compare two readers.
"""

from typing import Any

import numpy as np

from msb.adapters.checkpoint import BFloat16Array


def describe(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return `value` as JSON in which any difference in types or bits is visible.

    Arrays are appended to `arrays`.
    """
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


def assert_same_arrays(actual: list[np.ndarray], expected: list[np.ndarray]) -> None:
    """Check that arrays agree in all bits, including NaN and negative zero."""
    assert len(actual) == len(expected)
    for ours, theirs in zip(actual, expected, strict=True):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        assert ours.tobytes() == theirs.tobytes()
