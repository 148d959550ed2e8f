"""The list of devices, and the device that a selector chooses."""

import dataclasses
import json
from typing import Any

import pytest

from msb.cl import DeviceRecord, devices, list_devices, open_device
from msb.cl.devices import DEVICE_VARIABLE, PYOPENCL_VARIABLE, choose_device
from msb.cl.trial import Trial
from msb.errors import EXIT_STATUS, DeviceError
from tests.cl.conftest import SELECTOR

POCL = DeviceRecord(
    selector="pocl:0",
    platform="Portable Computing Language",
    platform_version="OpenCL 3.0 PoCL 3.0",
    platform_index=1,
    name="pthread-Some CPU",
    vendor="Vendor",
    version="OpenCL 3.0",
    driver="3.0",
    opencl_c="OpenCL C 1.2",
    kind="cpu",
    compute_units=2,
    clock_mhz=2000,
    global_memory=2**34,
    max_allocation=2**32,
    local_memory=2**15,
    local_memory_dedicated=False,
    max_work_group=4096,
    vector_width=8,
    int64_atomics=True,
    fp64=True,
    correctly_rounded=True,
    alignment=128,
    host_unified=True,
    timer_resolution_ns=1,
)


def other(**changes: Any) -> DeviceRecord:
    return dataclasses.replace(POCL, **changes)


NVIDIA = [
    other(selector=f"nvidia:{n}", platform="NVIDIA CUDA", platform_index=0, name=f"Card {n}", kind="gpu")
    for n in range(2)
]
INTEL = other(selector="intel:0", platform="Intel(R) OpenCL", platform_index=2, name="Some CPU")
ALL = [*NVIDIA, POCL, INTEL]


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> list[DeviceRecord]:
    """A machine with two GPUs and two CPU platforms."""
    records = list(ALL)
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    monkeypatch.delenv(PYOPENCL_VARIABLE, raising=False)
    monkeypatch.setattr(devices, "find_devices", lambda cl: [(record, None) for record in records])
    monkeypatch.setattr(devices, "try_device", lambda handle, record: Trial(True))
    return records


@pytest.mark.parametrize(
    ("selector", "expected"),
    [
        ("cpu", "pocl:0"),
        ("gpu", "nvidia:0"),
        ("GPU", "nvidia:0"),
        ("pocl", "pocl:0"),
        ("pocl:0", "pocl:0"),
        ("Portable", "pocl:0"),
        ("intel:0", "intel:0"),
        ("intel(r) opencl:0", "intel:0"),
        ("nvidia:1", "nvidia:1"),
        ("0", "nvidia:0"),
        ("0:1", "nvidia:1"),
        ("2:0", "intel:0"),
        ("nvidia:card 1", "nvidia:1"),
        ("0:1,0", "nvidia:1"),
    ],
)
def test_selector_chooses_a_device(machine: list[DeviceRecord], selector: str, expected: str) -> None:
    assert choose_device(selector).record.selector == expected


@pytest.mark.parametrize("selector", ["nvidia:2", "3", "amd", "pocl:1", "nvidia:card 7", "opengl", "0:-1"])
def test_unmatched_selector_is_an_error_that_lists_devices(
    machine: list[DeviceRecord], selector: str
) -> None:
    with pytest.raises(DeviceError, match="nvidia:0, nvidia:1, pocl:0, intel:0") as error:
        choose_device(selector)
    assert error.value.code == "DEVICE_NOT_FOUND"
    assert selector in error.value.message
    assert EXIT_STATUS[type(error.value)] == 5


def test_selector_precedence(machine: list[DeviceRecord], monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose_device() == (POCL, None, "default")
    monkeypatch.setenv(PYOPENCL_VARIABLE, "0:1")
    assert choose_device() == (NVIDIA[1], "0:1", PYOPENCL_VARIABLE)
    monkeypatch.setenv(DEVICE_VARIABLE, "intel")
    assert choose_device() == (INTEL, "intel", DEVICE_VARIABLE)
    assert choose_device("gpu") == (NVIDIA[0], "gpu", "argument")
    monkeypatch.setenv(DEVICE_VARIABLE, "")
    assert choose_device().source == PYOPENCL_VARIABLE


def test_default_device_is_pocl_then_a_cpu_then_any(machine: list[DeviceRecord]) -> None:
    machine.remove(POCL)
    assert choose_device().record is INTEL
    machine.remove(INTEL)
    assert choose_device().record is NVIDIA[0]
    machine.clear()
    with pytest.raises(DeviceError, match="PoCL") as error:
        choose_device("gpu")
    assert error.value.code == "DEVICE_NOT_FOUND"


def test_record_of_a_real_device() -> None:
    record = choose_device(SELECTOR).record
    assert record in list_devices()
    assert record.kind in ("cpu", "gpu")
    assert record.compute_units >= 1
    assert 1 <= record.vector_width <= 8
    assert record.max_allocation <= record.global_memory
    data = json.loads(json.dumps(record.to_dict()))
    assert data["selector"] == record.selector
    assert data["style"] == record.style


def test_cpu_style_requires_a_known_compiler() -> None:
    """The compiler of Mesa crashes if kernels use extensions of clang."""
    assert (POCL.style, INTEL.style) == ("cpu", "cpu")
    for platform in ("rusticl", "Oclgrind", "NVIDIA CUDA", "Apple"):
        assert other(platform=platform).style == "gpu"
    assert other(kind="gpu").style == "gpu"


def test_requested_style_is_used() -> None:
    with open_device(SELECTOR, style="gpu") as device:
        assert device.style == "gpu"
        assert device.record.style == choose_device(SELECTOR).record.style
