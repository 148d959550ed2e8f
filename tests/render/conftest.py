"""Devices for the tests of renderers."""

from collections.abc import Iterator

import pytest

from msb.cl import Device, open_device
from tests.cl.conftest import SELECTOR, fresh, styled

__all__ = ["fresh", "styled"]

device = styled
"""Run a test on a device in the CPU style, then in the GPU style. Test modules may override this fixture."""


@pytest.fixture(scope="module")
def cpu() -> Iterator[Device]:
    """Return a device with CPU-style kernels if its compiler supports them, else with GPU-style kernels."""
    with open_device(SELECTOR) as opened:
        yield opened


@pytest.fixture(scope="module")
def gpu() -> Iterator[Device]:
    with open_device(SELECTOR, style="gpu") as opened:
        yield opened
