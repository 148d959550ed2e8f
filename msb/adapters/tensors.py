"""Tensors of a checkpoint by key, with checks of existence, shape, type and finite values."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.adapters.checkpoint import BFloat16Array
from msb.asset.drawable import first_bad
from msb.errors import CheckpointError, Finding, finding, shorten

# The length of an axis, or a letter for an unknown length. All axes with the same letter must have equal
# lengths.
Axis = int | str

# Maps the number K of coefficients per channel to the SH degree L. The coefficient of degree 0 is not
# counted: K = (L + 1)^2 - 1.
SH_COEFFICIENTS = {0: 0, 3: 1, 8: 2, 15: 3}


class Tensors:
    """The named tensors of a file. Each tensor is checked when it is read.

    Parameters
    ----------
    values : mapping
        The dictionary from `read_checkpoint`: tensors and other values by key.
    file : Path
        The file that error messages name.
    check_values : bool
        Whether values that are not finite are errors.
    """

    def __init__(self, values: Mapping[Any, Any], file: Path, check_values: bool = True) -> None:
        self._values, self._file, self._check_values = values, file, check_values
        self._lengths: dict[str, tuple[int, str]] = {}
        self.warnings: list[Finding] = []

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def value(self, key: str) -> Any:
        """Return the value of `key`, of any type. The exact conversion of bfloat16 gives float32."""
        if key not in self._values:
            keys = ", ".join(shorten(str(name), 40) for name in list(self._values)[:16]) or "nothing"
            text = f'the key "{key}" is missing; the existing keys are {keys}'
            raise CheckpointError("CHECKPOINT_LAYOUT", text, file=self._file, pointer=key)
        value = self._values[key]
        return value.to_float32() if isinstance(value, BFloat16Array) else value

    def floats(self, key: str, *shape: Axis, infinite: bool = False) -> NDArray[np.float32]:
        """Return the tensor `key` of this `shape` as float32.

        float16 and bfloat16 are converted exactly; float64 is rounded, with a warning. With `infinite`,
        values may be infinite, because opacities of 0 and 1 have infinite logits. Axes with the same letter
        in `shape` have equal lengths in all tensors.
        """
        array = self._tensor(key, "float32", "f")
        self._check_shape(key, array.shape, shape)
        if array.dtype.itemsize > 4:
            text = f"{key} is {array.dtype.name}; it was rounded to float32, the type of assets"
            self.warnings.append(finding("CHECKPOINT_ROUNDED", text, severity="warning", pointer=key))
        with np.errstate(over="ignore"):  # overflows are detected below
            values = array.astype(np.float32, copy=False)
        if self._check_values and (at := first_bad(values, infinite=infinite)) is not None:
            text = f"{key}{list(at)} is {values[at]}; it must be {'a' if infinite else 'a finite'} number"
            raise self.error("CHECKPOINT_NONFINITE", text, f"{key}{list(at)}")
        return values

    def indices(self, key: str, vertices: int, *shape: Axis) -> NDArray[np.uint32]:
        """Return the integer tensor `key` as uint32. The values of the tensor must be 0 to `vertices` - 1."""
        array = self._tensor(key, "int32 or int64", "iu")
        self._check_shape(key, array.shape, shape)
        if array.size and not 0 <= int(array.min()) <= int(array.max()) < vertices:
            at = np.argwhere((array < 0) | (array >= vertices))[0].tolist()
            value = int(array[tuple(at)])
            text = f"{key}{at} is {value}; it must be from 0 to {vertices - 1}"
            raise self.error("CHECKPOINT_LAYOUT", text, f"{key}{at}")
        return array.astype(np.uint32)

    def number(self, key: str) -> float:
        """Return the number `key`: a Python number, or a tensor with one element."""
        value = self.value(key)
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.item()
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong_type(key, value, "a number")
        # this also rejects NaN, and integers that a float cannot represent exactly
        if not abs(value) < 1e300:
            text = f"{key} is {shorten(repr(value), 40)}; it must be a finite number"
            raise self.error("CHECKPOINT_NONFINITE", text, key)
        return float(value)

    def integer(self, key: str, low: int, high: int) -> int:
        """Return the integer `key`, from `low` to `high`."""
        number = self.number(key)
        if number != int(number) or not low <= number <= high:
            text = f"{key} is {number:g}; it must be a whole number from {low} to {high}"
            raise self.error("CHECKPOINT_LAYOUT", text, key)
        return int(number)

    def degree(self, key: str, coefficients: int) -> int:
        """Return the SH degree of a tensor `key` with `coefficients` per channel; degree 0 is not counted."""
        if coefficients not in SH_COEFFICIENTS:
            text = f"{key} has {coefficients} SH coefficients per channel; degrees 0 to 3 have 0, 3, 8 or 15"
            raise self.error("CHECKPOINT_LAYOUT", text, key)
        return SH_COEFFICIENTS[coefficients]

    def axis(self, key: str, number: int) -> int:
        """Return the unchecked length of an axis of the tensor `key`, or 0 if the tensor has no such axis."""
        shape = self._tensor(key, "float32", "fiu").shape
        return int(shape[number]) if number < len(shape) else 0

    def length(self, letter: str) -> int:
        """Return the length of all axes with the letter `letter`. Call `length` only after reading a tensor
        with this letter."""
        return self._lengths[letter][0]

    def error(self, code: str, text: str, pointer: str) -> CheckpointError:
        """Return an error about this file."""
        return CheckpointError(code, text, file=self._file, pointer=pointer)

    def _tensor(self, key: str, wanted: str, kinds: str) -> NDArray[Any]:
        value = self.value(key)
        if not isinstance(value, np.ndarray):
            raise self._wrong_type(key, value, "a tensor")
        if value.dtype.kind not in kinds:
            text = f"{key} is {value.dtype.name}; it must be {wanted}"
            raise self.error("CHECKPOINT_LAYOUT", text, key)
        return value

    def _wrong_type(self, key: str, value: Any, wanted: str) -> CheckpointError:
        if isinstance(value, np.ndarray):
            what = f"a tensor {list(value.shape)}"
        else:
            what = {type(None): "None", dict: "a dictionary", str: "text"}.get(
                type(value), f"of type {type(value).__name__}"
            )
        return self.error("CHECKPOINT_LAYOUT", f"{key} is {what}; it must be {wanted}", key)

    def _check_shape(self, key: str, shape: tuple[int, ...], wanted: tuple[Axis, ...]) -> None:
        """Check the shape of tensor `key`. The first tensor with a letter sets the length of the letter."""
        ok = len(shape) == len(wanted)
        for axis, length in zip(wanted, shape, strict=False):
            if isinstance(axis, int):
                ok = ok and axis == length
            elif ok:
                ok = self._lengths.setdefault(axis, (length, key))[0] == length
        if not ok:
            known = {a: self._lengths[a] for a in wanted if isinstance(a, str) and a in self._lengths}
            text = f"{key} has shape {list(shape)}; it must be {' x '.join(map(str, wanted))}"
            where = [f"{a} = {n} as in {k}" for a, (n, k) in known.items() if k != key]
            text += f" with {', '.join(where)}" if where else ""
            raise self.error("CHECKPOINT_LAYOUT", text, key)
        if 0 in [n for axis, n in zip(wanted, shape, strict=True) if isinstance(axis, str)]:
            text = f"{key} has shape {list(shape)}: the model is empty"
            raise self.error("CHECKPOINT_LAYOUT", text, key)
