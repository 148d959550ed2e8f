"""Device time by stage. What is measured is not asserted, only that it is, and under which name."""

import numpy as np
import pytest

from msb.cl import Device


def test_commands_count_to_their_stage(device: Device) -> None:
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
    found = timing.milliseconds()
    assert list(found) == ["other", "clear", "inner", "readback"]
    assert len(timing) == 6
    assert all(value >= 0 for value in found.values())
    assert 0 < timing.span() <= timing.since_queued()
    if not device.record.selector.startswith("rusticl"):  # 22.3 gives every fill the same nanosecond
        assert timing.span() >= max(found.values())


def test_nothing_is_collected_when_nobody_asks(device: Device) -> None:
    buffer = device.allocate(10, np.uint32)
    with device.stage("clear"):
        buffer.fill(1)
    with device.timing() as timing:
        pass
    assert timing.milliseconds() == {}
    assert timing.span() == 0
    assert len(timing) == 0


def test_timing_blocks_do_not_nest_and_end_after_an_error(device: Device) -> None:
    with pytest.raises(RuntimeError, match="nest"), device.timing(), device.timing():
        pass
    with device.timing() as timing:
        device.allocate(1, np.uint32).fill(1)
    assert len(timing) == 1
