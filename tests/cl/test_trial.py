"""Devices are tried in a child process, and the PoCL wheel is fixed if possible.

`tests.machines unknown` tests the images of a fixed wheel against the golden images.
"""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from msb.base.children import Reply, run_in_child
from msb.cl import DeviceRecord, devices, loader, pocl_fix, trial
from msb.cl.devices import choose_device, find_devices, open_device, shared_device
from msb.cl.trial import Trial, try_device
from msb.errors import DeviceError
from tests.cl.conftest import SELECTOR, Child, answer
from tests.cl.test_devices import INTEL, NVIDIA, other

UNKNOWN = "unknown target CPU 'generic'"
SYSTEM = other(selector="pocl:0", driver="3.1", platform_index=0)
WHEEL = other(selector="pocl:1", driver=pocl_fix.DRIVER)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Simulate a machine with these devices. The devices in `broken` do not build kernels."""
    for name in (devices.DEVICE_VARIABLE, devices.PYOPENCL_VARIABLE):
        monkeypatch.delenv(name, raising=False)

    def make(*records: DeviceRecord, broken: tuple[DeviceRecord, ...] = ()) -> None:
        monkeypatch.setattr(devices, "find_devices", lambda cl: [(record, record) for record in records])
        monkeypatch.setattr(devices.pocl_fix, "is_wheel", lambda handle: handle.driver == pocl_fix.DRIVER)
        failed = Trial(False, UNKNOWN)
        monkeypatch.setattr(
            devices, "try_device", lambda handle, record, **_: failed if record in broken else Trial(True)
        )

    return make


@pytest.mark.parametrize(
    ("there", "broken", "selector", "expected"),
    [
        ((WHEEL, SYSTEM, INTEL), (), None, SYSTEM),
        ((WHEEL, SYSTEM, INTEL), (SYSTEM,), None, WHEEL),
        ((*NVIDIA, WHEEL, INTEL), (WHEEL,), None, INTEL),
        ((*NVIDIA, WHEEL), (WHEEL,), None, NVIDIA[0]),
        ((*NVIDIA, WHEEL), (NVIDIA[0],), "gpu", NVIDIA[1]),
        ((WHEEL, INTEL), (WHEEL,), "cpu", INTEL),
        ((WHEEL, SYSTEM), (SYSTEM,), "pocl", WHEEL),
        ((WHEEL, SYSTEM), (), "pocl", SYSTEM),
        ((SYSTEM, WHEEL), (), "pocl:1", WHEEL),
    ],
)
def test_devices_that_do_not_build_are_skipped(
    machine: Callable[..., None],
    there: tuple[DeviceRecord, ...],
    broken: tuple[DeviceRecord, ...],
    selector: str | None,
    expected: DeviceRecord,
) -> None:
    machine(*there, broken=broken)
    assert choose_device(selector).record is expected


@pytest.mark.parametrize("selector", ["pocl", "pocl:1", "portable", None])
def test_error_without_a_building_device_quotes_the_compiler(
    machine: Callable[..., None], selector: str | None
) -> None:
    machine(WHEEL, *((INTEL,) if selector else ()), broken=(WHEEL,))
    with pytest.raises(DeviceError) as error:
        choose_device("pocl:0" if selector == "pocl:1" else selector)
    assert error.value.code == "DEVICE_BUILD"
    assert error.value.exit_status == 5
    for words in (WHEEL.selector, UNKNOWN, "does not support this processor", "pocl-opencl-icd"):
        assert words in error.value.message
    assert "\n" not in str(error.value)


# Trials of a real device.


@pytest.fixture
def real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, DeviceRecord]]:
    """Return the test device, after forgetting the results of earlier trials."""
    chosen = choose_device(SELECTOR).record
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    trial.forget()
    pairs = find_devices(loader.opencl())
    yield next((handle, record) for record, handle in pairs if record.selector == chosen.selector)
    trial.forget()


def children(monkeypatch: pytest.MonkeyPatch, reply: Reply | None = None) -> list[str]:
    """Count the child processes that try a device, and optionally replace their reply."""
    started: list[str] = []

    def counted(work: Any, word: str, *rest: Any) -> Reply:
        started.append(word)
        return run_in_child(work, word, *rest) if reply is None else reply

    monkeypatch.setattr(trial, "run_in_child", counted)
    return started


@pytest.mark.slow
def test_trial_result_is_cached_per_driver(
    real: tuple[Any, DeviceRecord], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started = children(monkeypatch)
    assert try_device(*real).builds
    assert len(started) >= 1
    kept = tmp_path / "meshsplatbench" / "devices.txt"
    assert [line.split()[1] for line in kept.read_text().splitlines()] == ["builds"]
    before = len(started)
    assert try_device(*real).builds
    trial.forget()  # like a new process
    assert try_device(*real).builds
    assert len(started) == before
    assert try_device(*real, again=True).builds
    assert len(started) > before
    trial.forget()
    before = len(started)
    try_device(real[0], dataclasses.replace(real[1], driver="another"))
    assert len(started) > before


@pytest.mark.parametrize(
    "reply", [Reply(UNKNOWN), Reply(why="it crashed (status 8): LLVM ERROR: no such intrinsic")]
)
def test_compiler_failures_are_cached_but_crashes_are_not(
    real: tuple[Any, DeviceRecord], monkeypatch: pytest.MonkeyPatch, reply: Reply, tmp_path: Path
) -> None:
    monkeypatch.setenv(pocl_fix.FIX_VARIABLE, "0")
    children(monkeypatch, reply)
    tried = try_device(*real)
    assert not tried.builds
    assert (reply.data or reply.why) in (tried.why or "")
    # A compiler error is permanent. A crash may have another cause, so it is not cached.
    assert (tmp_path / "meshsplatbench").exists() == (reply.data == UNKNOWN)


# The PoCL wheel on an unknown processor.

SHOW = """
from msb.cl import loader, pocl_fix
from msb.cl.devices import open_device
from msb.cl.trial import try_device
from msb.cl.devices import find_devices
from msb.errors import DeviceError, OutputError
wheel = next((r, h) for r, h in find_devices(loader.opencl()) if r.driver == pocl_fix.DRIVER)
print(pocl_fix.compiler_cpu(wheel[1]))
try:
    with open_device(wheel[0].selector) as device:
        print(device.program("scan_cpu", {"SUM": "uint"}).name)
except DeviceError as error:
    print(error)
print(pocl_fix.compiler_cpu(wheel[1]))
print(try_device(wheel[1], wheel[0]).mended)
"""


@pytest.mark.slow
def test_pocl_wheel_is_fixed_on_an_unknown_processor(child: Child, unknown: dict[str, str]) -> None:
    for _ in range(2):  # the second process uses the cache
        before, kernels, *after = answer(child(SHOW, **unknown)).splitlines()
        assert (before, kernels.split("/")[1], after) == ("generic", "scan_cpu.cl", ["haswell"] * 2)


@pytest.mark.slow
def test_environment_variable_disables_the_pocl_fix(child: Child, unknown: dict[str, str]) -> None:
    lines = answer(child(SHOW, **{**unknown, pocl_fix.FIX_VARIABLE: "0"})).splitlines()
    assert lines[0] == lines[2] == "generic"
    assert lines[1].startswith("DEVICE_BUILD: pocl:")
    assert UNKNOWN in lines[1]
    assert pocl_fix.FIX_VARIABLE in lines[1]
    assert lines[3] == "None"


@pytest.mark.slow
def test_processor_name_is_kept_if_the_fixed_trial_fails(child: Child, unknown: dict[str, str]) -> None:
    failing = """
from msb.cl import trial
find_failure = trial._find_failure
trial._find_failure = lambda record, *, mended: ("no", True) if mended else find_failure(record, mended=False)
"""
    lines = answer(child(failing + SHOW, **unknown)).splitlines()
    assert lines[0] == lines[2] == "generic"
    assert lines[1].startswith("DEVICE_BUILD: pocl:")


@pytest.mark.parametrize(
    "flags",
    [
        "fpu sse2",
        "fpu sse2 avx avx2 fma bmi1 bmi2 f16c movbe",
        "avx2 bmi1 bmi2 f16c movbe abm",
        "",
    ],
)
def test_pocl_fix_requires_the_features_of_haswell(monkeypatch: pytest.MonkeyPatch, flags: str) -> None:
    monkeypatch.delenv(pocl_fix.FIX_VARIABLE, raising=False)
    read = Path.read_text
    monkeypatch.setattr(
        pocl_fix.Path,
        "read_text",
        lambda self, *args: f"flags\t\t: {flags}\n" if self.name == "cpuinfo" else read(self),
    )
    assert "lacks" in (pocl_fix.obstacle() or "")


# One device per process.


def test_shared_device_is_opened_once() -> None:
    first = shared_device(SELECTOR)
    assert shared_device(SELECTOR) is first
    assert shared_device(first.record.selector) is first
    with open_device(SELECTOR) as separate:
        assert separate is not first


def test_failed_shared_device_is_reopened() -> None:
    first = shared_device(SELECTOR, style="gpu")
    first._queue.failed = True
    second = shared_device(SELECTOR, style="gpu")
    assert second is not first
    second.close()
    assert shared_device(SELECTOR, style="gpu") is not second


def test_forked_process_cannot_use_the_device_of_its_parent(monkeypatch: pytest.MonkeyPatch) -> None:
    shared_device(SELECTOR)
    monkeypatch.setattr(devices.os, "getpid", lambda: -1)
    with pytest.raises(DeviceError, match="forked"):
        shared_device(SELECTOR)


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"\xff\n\0\nkey\nkey perhaps", b"k" * (1 << 20)])
def test_a_damaged_cache_is_ignored(real: tuple[Any, DeviceRecord], tmp_path: Path, content: bytes) -> None:
    cache = tmp_path / "meshsplatbench" / "devices.txt"
    cache.parent.mkdir()
    cache.write_bytes(content)
    assert try_device(*real).builds
    assert len(cache.read_text().splitlines()) == 1
