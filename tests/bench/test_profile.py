"""Timing apart from capture: what is counted, and how it is summed up."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from msb.bench.profile import profile
from msb.render.protocol import Drawn


class Fake:
    """Takes 1, 2, 3, ... ms a frame, and remembers what it was asked."""

    def __init__(self) -> None:
        self.drawn: list[Any] = []

    def draw(self, camera: Any, background: Any) -> Drawn:
        self.drawn.append(camera)
        number = len(self.drawn)
        time.sleep(0.0005)
        return Drawn({"raster": float(number), "shade": 1.0}, span=number + 1.5)

    def memory(self) -> dict[str, int]:
        return {"geometry": 100, "scratch": 5}

    def render(self, *_: Any) -> None:
        pytest.fail("a timing run reads nothing back")


def test_percentiles_are_interpolated_and_warm_up_is_left_out() -> None:
    renderer, steps = Fake(), []
    found = profile(renderer, ["a", "b", "c"], frames=20, seconds=0, step=lambda: steps.append(1))  # type: ignore[arg-type]
    warm = len(renderer.drawn) - 20
    assert warm == 10
    spans = np.arange(warm + 1, warm + 21) + 1.5
    assert found.frames == 20 == len(steps)
    assert found.p50 == np.percentile(spans, 50)
    assert found.p95 == np.percentile(spans, 95)
    assert found.busy_p50 == pytest.approx(found.p50 - 0.5)
    assert found.stages == {"raster": np.median(spans) - 1.5, "shade": 1.0}
    assert found.memory == {"geometry": 100, "scratch": 5}
    # 1000 / FPS cannot be less than what the clock saw of each frame.
    assert 1000 / found.fps >= 0.5


def test_cameras_take_turns_and_time_counts_too() -> None:
    renderer = Fake()
    profile(renderer, ["a", "b"], frames=1, seconds=0.05)  # type: ignore[arg-type]
    timed = renderer.drawn[1:]
    assert timed[:4] == ["a", "b", "a", "b"]
    assert len(timed) > 5
    with pytest.raises(ValueError, match="there is no camera"):
        profile(renderer, [], frames=1)  # type: ignore[arg-type]


def test_warm_up_is_counted_in_frames_and_a_budget_ends_it_all() -> None:
    renderer = Fake()
    assert profile(renderer, ["a"], frames=4, seconds=0, warm_up=3).frames == 4  # type: ignore[arg-type]
    assert len(renderer.drawn) == 7
    renderer = Fake()
    profile(renderer, ["a"], frames=4, seconds=0, warm_up=0)  # type: ignore[arg-type]
    assert len(renderer.drawn) == 4
    renderer = Fake()
    found = profile(renderer, ["a"], frames=10**6, seconds=0, budget=0.02)  # type: ignore[arg-type]
    assert 1 <= found.frames < len(renderer.drawn) < 100
    assert profile(Fake(), ["a"], frames=9, warm_up=9, budget=0).frames == 1  # type: ignore[arg-type]


def test_json_has_what_the_tables_need() -> None:
    data = profile(Fake(), ["a"], frames=3, seconds=0).to_dict()  # type: ignore[arg-type]
    assert set(data) == {"frames", "device_ms", "busy_ms", "stages_ms", "fps", "memory_bytes"}
    assert set(data["device_ms"]) == {"p50", "p95", "mean"}
