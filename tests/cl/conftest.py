"""One PoCL device for all tests, in both styles of kernels."""

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
SELECTOR = os.environ.get("MSB_DEVICE") or "pocl"
"""The tests' platform; another one is tested with MSB_DEVICE."""
WITHOUT_ATOMICS = "gpu without 64-bit atomics"
STYLES = ("cpu", "gpu", WITHOUT_ATOMICS)


def open_styled(style: str) -> Device:
    """Open the tests' device for one of STYLES; skip the CPU's where its compiler is not known to take it."""
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
    """Return a device of the test's own, with nothing on it."""
    with open_device(SELECTOR) as opened:
        yield opened


@pytest.fixture(scope="session", params=["cpu", "gpu"])
def styled(request: pytest.FixtureRequest) -> Iterator[Device]:
    """Return a device that uses the CPU style, then one that uses the GPU style, of kernels."""
    with open_styled(request.param) as opened:
        yield opened


class Child(Protocol):
    """Run Python code in a process of its own."""

    def __call__(self, code: str, **env: str | None) -> subprocess.Popen[str]: ...


@pytest.fixture(scope="session")
def child() -> Child:
    """Return a function that starts a Python process; a variable given as None is unset in it."""

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
    """Return what a child printed, once it ended well."""
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.strip()
