"""Kernel files: includes, defines, builds, and the checks of a launch."""

import dataclasses
import itertools
import sys
import threading
import weakref
import zipfile
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from msb.cl import Buffer, Device, Kernel, LocalMemory
from msb.cl.kernel_text import resolve, write_defines
from msb.cl.programs import _ERROR_LINE
from msb.errors import DeviceError
from tests.cl.conftest import KERNELS


def scaled(device: Device, **defines: Any) -> list[float]:
    return launched(device, **defines)[2].read().tolist()


def launched(device: Device, **defines: Any) -> tuple[Kernel, Buffer, Buffer]:
    """Return a kernel after a launch, with its input and its output."""
    kernel = device.program("simple", {"OFFSET": 0, **defines}, KERNELS).scaled
    given, out = device.upload(np.arange(5, dtype=np.float32)), device.allocate(5, np.float32)
    kernel(5, 4, given, out, np.uint32(5))
    return kernel, given, out


@pytest.mark.slow
def test_defines_and_includes_reach_the_kernel(device: Device) -> None:
    assert scaled(device) == [0, 2, 4, 6, 8]
    assert scaled(device, OFFSET=1) == [1, 3, 5, 7, 9]
    assert scaled(device, SCALE="(1 + 2)") == [0, 3, 6, 9, 12]
    assert scaled(device, SCALE=0.1)[3] == np.float32(0.1) * np.float32(3)  # floats are exact


@pytest.mark.slow
def test_program_is_built_once_per_set_of_defines(device: Device) -> None:
    first = device.program("simple", {"OFFSET": 0, "SCALE": 7}, KERNELS)
    assert device.program("simple", {"SCALE": 7, "OFFSET": 0}, KERNELS) is first
    second = device.program("simple", {"OFFSET": 1, "SCALE": 7}, KERNELS)
    assert second is not first
    assert first.name == f"{KERNELS}/simple.cl"
    assert first.scaled is first.scaled
    assert "scaled" in dir(first)
    with pytest.raises(AttributeError, match="nothing"):
        _ = first.nothing


@pytest.mark.parametrize(
    "defines", [{"A B": 1}, {"1A": 1}, {"A": "x\ny"}, {"A": float("nan")}, {"A": float("inf")}, {"": 1}]
)
def test_invalid_macros_are_rejected(defines: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"macro|constant"):
        write_defines(defines)


def test_our_kernels_can_be_included_from_another_package() -> None:
    assert "group_scan(" in resolve("msb.cl.kernels", "scan_gpu.cl")
    assert resolve(KERNELS, "group_scan.cl") == resolve("msb.cl.kernels", "group_scan.cl")


@pytest.mark.parametrize(
    ("name", "error", "text"),
    [
        ("loops.cl", ValueError, "includes itself"),
        ("foreign.cl", ValueError, "line 2"),
        ("absent.cl", FileNotFoundError, r"absent\.cl"),
    ],
)
def test_invalid_includes_are_rejected(name: str, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        resolve(KERNELS, name)


def test_kernels_are_read_from_a_zip(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(tmp_path / "zipped.zip", "w") as archive:
        archive.writestr("zipped_kernels/__init__.py", "")
        archive.writestr("zipped_kernels/one.cl", '#include "two.cl"\n')
        archive.writestr("zipped_kernels/two.cl", "__kernel void k(__global int *out) { out[0] = N; }\n")
    monkeypatch.syspath_prepend(str(tmp_path / "zipped.zip"))
    program = device.program("one", {"N": 42}, "zipped_kernels")
    out = device.allocate(1, np.int32)
    program.k(1, 1, out)
    assert out.read().tolist() == [42]
    sys.modules.pop("zipped_kernels", None)


def test_build_error_names_file_line_and_message(device: Device) -> None:
    with pytest.raises(DeviceError) as error:
        device.program("broken", package=KERNELS)
    assert error.value.code == "DEVICE_BUILD"
    assert error.value.file == "broken_part.cl"
    assert error.value.pointer == "line 4"
    assert "no_such_name" in error.value.message
    assert device.record.selector in error.value.message
    assert "\n" not in str(error.value)
    assert any("no_such_name" in note and "\n" in note for note in error.value.__notes__)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("error: a.cl:4:12: no such name", "no such name"),  # PoCL
        ("a.cl:4:12: error: no such name", "no such name"),  # Intel, NVIDIA
        ("a.cl:4:12: fatal error: no such name", "no such name"),
        ("a.cl:4:12: warning: not used", None),
        ("warning: a.cl:4:12: not used", None),
        ("a.cl:4:12: note: declared here", None),
        ("Compilation failed", None),
    ],
)
def test_compiler_errors_are_recognised(line: str, text: str | None) -> None:
    match = _ERROR_LINE.match(line)
    assert (match and match["text"]) == text
    assert not match or (match["file"], match["line"]) == ("a.cl", "4")


def test_unchanged_arguments_are_not_set_again(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    scale, given, out = launched(device)
    handle = Mock(wraps=scale._handle)
    monkeypatch.setattr(device._queue.cl, "enqueue_nd_range_kernel", Mock())
    monkeypatch.setattr(scale, "_handle", handle)
    scale(5, 4, given, out, np.uint32(5))
    assert not handle.set_arg.called
    scale(5, 1, given, out, np.uint32(4))
    assert [call.args for call in handle.set_arg.call_args_list] == [(2, np.uint32(4))]


def test_kernel_does_not_keep_buffers_alive(device: Device) -> None:
    scale, given, out = launched(device)
    gone = weakref.ref(given.allocation)
    replacement = device.upload(np.full(5, 7, np.float32))
    del given
    assert gone() is None
    scale(5, 1, replacement, out, np.uint32(5))
    assert out.read().tolist() == [14] * 5


def test_contraction_off_and_division_round_as_numpy(device: Device) -> None:
    given = np.random.default_rng(3).standard_normal((4096, 3)).astype(np.float32)
    out = device.allocate((4096, 2), np.float32)
    device.program("simple", {"OFFSET": 0}, KERNELS).fused(
        4096, 64, device.upload(given), out, np.uint32(4096)
    )
    a, b, c = given.T
    result = out.read()
    assert np.array_equal(result[:, 0], a * b + c)
    if device.record.correctly_rounded:  # PoCL is
        assert np.array_equal(result[:, 1], a / b)
    else:
        np.testing.assert_array_max_ulp(result[:, 1], a / b, 3)


def test_wrong_kernel_arguments_are_rejected(device: Device) -> None:
    out = device.allocate(4, np.float32)
    good = [out, np.ones(4, np.float32), np.ones(3, np.uint32), np.uint64(1), np.int8(1), LocalMemory(4)]
    bad: list[list[Any]] = [
        [np.zeros(4, np.float32), None],
        [np.ones(3, np.float32), np.ones(4), [1, 2, 3, 4]],
        [np.ones(4, np.uint32), np.ones(3, np.int32)],
        [1, np.uint32(1), np.int64(1), np.float64(1)],
        [1, np.uint8(1), True],
        [4, np.uint32(4), out],
    ]
    typed = device.program("simple", {"OFFSET": 0}, KERNELS).typed
    for number, value in itertools.chain(*([(n, v) for v in values] for n, values in enumerate(bad))):
        arguments = [*good[:number], value, *good[number + 1 :]]
        with pytest.raises(TypeError, match=f"typed: argument {number}"):
            typed(1, 1, *arguments)
    with pytest.raises(TypeError, match="takes 6 arguments, not 5"):
        typed(1, 1, *good[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("group", [(8,), (2, 4)])
@pytest.mark.parametrize("who", ["device", "kernel"])
def test_too_large_work_groups_are_rejected(
    who: str, group: tuple[int, ...], fresh: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit of a kernel is checked at its launch, because some platforms report wrong limits."""
    out = fresh.upload(np.ones(4, np.float32))
    kernel = fresh.program("simple", {"OFFSET": 0}, KERNELS).scaled
    arguments = (48,) * len(group), group, out, out, np.uint32(0)
    monkeypatch.setattr(kernel, "max_work_group", 7)
    assert kernel(*arguments) is not None
    if who == "device":
        fresh._queue.record = dataclasses.replace(fresh.record, max_work_group=7)
    else:
        error = fresh._queue.cl.LogicError("clEnqueueNDRangeKernel", -54, "")
        monkeypatch.setattr(fresh._queue.cl, "enqueue_nd_range_kernel", Mock(side_effect=error))
    with pytest.raises(DeviceError, match=r"scaled.* 7;") as caught:
        kernel(*arguments)
    assert (caught.value.code, caught.value.exit_status) == ("DEVICE_COMMAND", 5)
    assert "msb devices" in caught.value.message


@pytest.mark.slow
def test_threads_share_a_device(device: Device) -> None:
    wrong: list[int] = []

    def work(offset: int) -> None:
        for _ in range(20):
            if scaled(device, OFFSET=offset % 2) != [offset % 2 + 2 * i for i in range(5)]:
                wrong.append(offset)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_commands_are_timed_by_stage(device: Device) -> None:
    buffer = device.allocate(1000, np.uint32)
    with device.timing() as timing:
        buffer.fill(1)
        with device.stage("clear"):
            buffer.fill(2)
            with device.stage("inner"):
                buffer.fill(3)
            buffer.fill(4)
        with device.stage("readback"):
            buffer.read()
        with device.stage("clear"):
            buffer.fill(5)
    times = timing.milliseconds()
    assert list(times) == ["other", "clear", "inner", "readback"]
    assert len(timing) == 6
    assert all(value >= 0 for value in times.values())
    assert 0 < timing.span() <= timing.since_queued()
    if not device.record.selector.startswith("rusticl"):  # version 22.3 reports the same times for all fills
        assert timing.span() >= max(times.values())


def test_timing_is_limited_to_its_block(device: Device) -> None:
    buffer = device.allocate(10, np.uint32)
    with device.stage("clear"):
        buffer.fill(1)
    with device.timing() as timing:
        pass
    assert (timing.milliseconds(), timing.span(), len(timing)) == ({}, 0, 0)
    with pytest.raises(RuntimeError, match="nest"), device.timing(), device.timing():
        pass
    with device.timing() as timing:
        buffer.fill(1)
    assert len(timing) == 1
