"""MATLAB 5 files: arrays are those that SciPy reads."""

from __future__ import annotations

import io
import zlib
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from msb.metrics.matlab import find_variables

RNG = np.random.default_rng(0)
NUMBERS: dict[str, Any] = {
    "ObsMask": RNG.integers(0, 2, (5, 4, 3)).astype(np.uint8),
    "BB": RNG.normal(size=(2, 3)),
    "whole": np.arange(6.0).reshape(2, 3),
    "single": RNG.normal(size=(2, 2)).astype(np.float32),
    "wide": np.arange(-3, 3).reshape(1, 2, 3),
    "flags": np.array([[True, False]]),
    "empty": np.zeros((0, 3)),
    "a_name_of_more_than_four_letters": np.uint8([[7]]),
}


def saved(*, packed: bool = False, **variables: Any) -> bytes:
    stream = io.BytesIO()
    savemat(stream, variables, do_compression=packed)
    return stream.getvalue()


@pytest.mark.parametrize("packed", [False, True])
def test_arrays_are_those_that_scipy_reads(packed: bool) -> None:
    content = saved(packed=packed, **NUMBERS)
    wanted, found = loadmat(io.BytesIO(content)), find_variables(content)
    assert list(found) == list(NUMBERS)
    for name, variable in found.items():
        values = variable.read()
        assert variable.shape == values.shape == wanted[name].shape
        np.testing.assert_array_equal(values, wanted[name])
        assert not values.flags.writeable


def test_what_is_no_array_of_real_numbers_is_refused() -> None:
    content = saved(text="a", cell=np.array([["x"]], object), table={"a": 1}, complex=np.array([[1j]]))
    for variable in find_variables(content).values():
        with pytest.raises(ValueError, match=f"{variable.name} holds no real numbers"):
            variable.read()


def test_numbers_are_unpacked_no_further_than_the_shape_says() -> None:
    """A variable that goes on for a gigabyte behind its numbers costs nothing."""
    content = bytearray(saved(packed=True, Res=np.array([[0.5]])))
    body = zlib.decompress(bytes(content[136:]))
    longer = zlib.compress(body + bytes(1 << 24), 9)
    content[132:] = len(longer).to_bytes(4, "little") + longer
    assert find_variables(bytes(content))["Res"].read().tolist() == [[0.5]]
