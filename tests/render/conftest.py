"""Devices for the tests of renderers."""

from collections.abc import Iterator

import pytest

from msb.cl import Device, open_device
from tests.cl.conftest import SELECTOR, fresh, styled

__all__ = ["fresh", "styled"]

device = styled
"""In the CPU style, then in the GPU style, unless a module says otherwise."""


@pytest.fixture(scope="module")
def cpu() -> Iterator[Device]:
    """Return a device that uses the CPU style, where its compiler is known to take it, else the GPU style."""
    with open_device(SELECTOR) as opened:
        yield opened


@pytest.fixture(scope="module")
def gpu() -> Iterator[Device]:
    with open_device(SELECTOR, style="gpu") as opened:
        yield opened
