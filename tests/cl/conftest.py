"""A PoCL device for all tests, in both styles of kernels."""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import pytest

from msb.cl import Device, open_device
from msb.cl.devices import choose_device
from tests.conftest import ROOT

KERNELS = "tests.cl.kernels"
# The platform of the tests; MSB_DEVICE selects another one.
SELECTOR = os.environ.get("MSB_DEVICE") or "pocl"
WITHOUT_ATOMICS = "gpu without 64-bit atomics"
STYLES = ("cpu", "gpu", WITHOUT_ATOMICS)


def open_styled(style: str) -> Device:
    """Open the test device for one of STYLES. Skip the CPU style if the compiler may not accept it."""
    if style == "cpu" and choose_device(SELECTOR).record.style != "cpu":
        pytest.skip(f"the compiler of {SELECTOR} is not known to take the CPU style")
    opened = open_device(SELECTOR, style="cpu" if style == "cpu" else "gpu")
    if style == WITHOUT_ATOMICS:
        opened.record = replace(opened.record, int64_atomics=False)
    return opened


@pytest.fixture(scope="session")
def device() -> Iterator[Device]:
    """Return an open device that all tests share."""
    with open_device(SELECTOR) as opened:
        yield opened


@pytest.fixture
def fresh() -> Iterator[Device]:
    """Return a separate device without programs and buffers."""
    with open_device(SELECTOR) as opened:
        yield opened


@pytest.fixture(scope="session", params=["cpu", "gpu"])
def styled(request: pytest.FixtureRequest) -> Iterator[Device]:
    """Return a device with CPU-style kernels, then one with GPU-style kernels."""
    with open_styled(request.param) as opened:
        yield opened


class Child(Protocol):
    """Run Python code in a separate process."""

    def __call__(self, code: str, **env: str | None) -> subprocess.Popen[str]: ...


@pytest.fixture(scope="session")
def child() -> Child:
    """Return a function that starts a Python process. Variables given as None are unset in it."""

    def start(code: str, **env: str | None) -> subprocess.Popen[str]:
        whole = {**os.environ, "PYTHONPATH": str(ROOT), **env}
        return subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={key: value for key, value in whole.items() if value is not None},
        )

    return start


def answer(process: subprocess.Popen[str]) -> str:
    """Return the output of a child process after it ended successfully."""
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.strip()
