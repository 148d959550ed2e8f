"""Timing apart from capture, of a model and of one triangle of it: what is counted and how."""

import time
from typing import Any

import numpy as np
import pytest

import msb
from msb.bench.floor import one_triangle
from msb.bench.parts import grouped
from msb.bench.profile import profile
from msb.render.backend import SETTLED_AT, Drawn
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS


class Fake:
    """Takes 1, 2, 3, ... ms a frame, and remembers what it was asked."""

    def __init__(self) -> None:
        self.drawn: list[Any] = []

    def draw(self, camera: Any, background: Any) -> Drawn:
        self.drawn.append(camera)
        number = len(self.drawn)
        time.sleep(0.0005)
        return Drawn({"raster": float(number), "shade": 1.0}, number + 1.5, number + 2.0)

    def memory(self) -> dict[str, int]:
        settled = len(self.drawn) >= SETTLED_AT
        return {"geometry": 100, "scratch": 5 + settled, "lists": max(map(ord, self.drawn))}

    def memory_groups(self) -> dict[str, str]:
        return {}

    def render(self, *_: Any) -> None:
        pytest.fail("a timing run reads nothing back")


def test_percentiles_are_interpolated_and_warm_up_is_left_out() -> None:
    renderer, steps = Fake(), []
    found = profile(renderer, ["a", "b", "c"], frames=20, seconds=0, step=lambda: steps.append(1))
    warm = len(renderer.drawn) - 20
    assert warm == 10
    spans = np.arange(warm + 1, warm + 21) + 1.5
    timing = found.timing
    assert timing.frames == 20 == len(steps)
    assert (timing.p50_ms, timing.p95_ms) == tuple(np.percentile(spans, (50, 95)))
    assert timing.busy_p50_ms == pytest.approx(timing.p50_ms - 0.5)
    assert timing.queued_p50_ms == pytest.approx(timing.p50_ms + 0.5)
    assert len(timing.round_fps) == 5
    assert min(timing.round_fps) <= timing.fps <= max(timing.round_fps)
    assert timing.stages_ms == {"raster": np.median(spans) - 1.5, "shade": 1.0}
    assert found.memory == {"geometry": 100, "scratch": 6, "lists": ord("c")}
    # 1000 / FPS cannot be less than what the clock saw of each frame.
    assert 1000 / timing.fps >= 0.5


def test_cameras_take_turns_and_time_counts_too() -> None:
    renderer = Fake()
    found = profile(renderer, ["a", "b"], frames=1, seconds=0.5)
    timed = renderer.drawn[1:]
    assert timed[:4] == ["a", "b", "a", "b"]
    assert len(renderer.drawn) == 1 + found.timing.frames
    assert len(timed) > 5
    with pytest.raises(ValueError, match="no camera"):
        profile(renderer, [], frames=1)


@pytest.mark.parametrize(("frames", "warm_up"), [(1, 0), (2, 0), (2, 1), (1, 3), (9, 4), (4, None)])
def test_memory_is_of_every_camera_and_of_a_settled_renderer(frames: int, warm_up: int | None) -> None:
    for cameras in ("a", "abc", "cba", "abcdefgh"):
        found = profile(Fake(), cameras, frames=frames, seconds=0, warm_up=warm_up)
        assert found.timing.frames == frames
        assert found.memory == {"geometry": 100, "scratch": 6, "lists": ord(max(cameras))}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["triangle_splatting", "mesh_splatting"])
def test_memory_does_not_depend_on_how_many_frames_the_clock_saw(method: str) -> None:
    scene = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble")
    asset, found = msb.export(PEBBLE / method), []
    for warm_up in (0, 1, 10):
        with msb.Renderer(asset, tier="dedicated") as renderer:
            timed = profile(renderer, scene.test, scene.background, frames=1, seconds=0, warm_up=warm_up)
        found.append(timed.memory)
    assert found[0] == found[1] == found[2]


def test_json_has_what_the_tables_need() -> None:
    data = profile(Fake(), ["a"], frames=3, seconds=0).to_dict()
    numbers = {"frames", "fps", "round_fps"}
    assert set(data) == numbers | {"device_ms", "busy_ms", "queued_ms", "stages_ms", "memory_bytes"}
    assert set(data["device_ms"]) == {"p50", "p95", "mean"}


def test_memory_of_unknown_use_is_scratch() -> None:
    found = grouped({"vulkan heap": 5, "positions": 7}, {"positions": "geometry"})
    assert (found.scratch, found.geometry, found.total) == (5, 7, 12)
    assert found.uses == {"vulkan heap": 5, "positions": 7}


@pytest.mark.parametrize("method", ["two_dts", "triangle_splatting", "mesh_splatting", "diffsoup"])
def test_one_triangle_holds_all_that_the_first_one_has(method: str) -> None:
    whole = msb.export(PEBBLE / method)
    single = one_triangle(whole)
    assert (single.manifest.face_count, single.manifest.vertex_count) == (1, 3)
    corners = whole.buffers["indices"][0]
    np.testing.assert_array_equal(single.buffers["positions"], whole.buffers["positions"][corners])
    assert single.buffers.keys() == whole.buffers.keys()
    assert single.manifest.settings == whole.manifest.settings
    camera = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble").test[0]
    frame = msb.render(single, camera, tier="dedicated", background=(1.0, 1.0, 1.0))
    assert (frame.image == 1).mean() > 0.9
