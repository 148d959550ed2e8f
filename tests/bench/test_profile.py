"""`msb bench` and the timing of runs: what is counted and how, of a model and of one triangle of it."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
import msb as library
from msb.bench.floor import one_triangle
from msb.bench.parts import grouped
from msb.bench.profile import profile
from msb.render.backend import SETTLED_AT, Drawn
from msb.scenes import turntable, write_cameras
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS
from tests.cli.conftest import Here


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


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    views = turntable((0.5, 0.5, 0.5), 2.2, up=(0, 1, 0), count=3, width=60, height=44, fov_y=0.7)
    write_cameras(views, tmp_path / "views.json")
    return tmp_path / "views.json"


@pytest.mark.slow
def test_bench_records_and_compares(here: Here, demo_asset: Path, cameras: Path, tmp_path: Path) -> None:
    record = tmp_path / "old.json"
    args = ("bench", "--cameras", cameras, "--repeat", "4", "--seconds", "0")
    assert here(*args, "--json", record, demo_asset).status == 0
    data = json.loads(record.read_text())
    assert data["schema"] == "msb.bench/1"
    assert (data["frames"], data["memory_views"]) == (4, data["views"])
    assert data["machine"]["device"]["platform"]
    assert 0 < data["device_ms"]["p50"] <= data["device_ms"]["p95"]
    assert sum(data["memory_bytes"].values()) > library.load(demo_asset).buffers["indices"].nbytes
    assert sum(data["stages_ms"].values()) <= 2 * data["device_ms"]["p95"]
    assert here(*args, "--compare", record, demo_asset).status == 0
    fast = {**data, "device_ms": {**data["device_ms"], "p50": data["device_ms"]["p50"] / 1000}, "faces": 1}
    (tmp_path / "fast.json").write_text(json.dumps(fast))
    result = here(*args, "--compare", tmp_path / "fast.json", "--fail-slower", "900%", demo_asset)
    note, failure = result.err.splitlines()
    assert result.status == 1
    assert "34761" in note  # faces differ: not the same is compared
    assert failure.startswith("GATE_FAILED: ")
    here(*args, "--compare", record, "--fail-slower", "ten", demo_asset).ends(2, "USAGE: --fail-slower")
    modes = ("--tier", "dedicated", "--order", "none", "--sampling", "engine")
    data = here(*args, *modes, "--json", "-", demo_asset).json
    assert (data["order"], data["sampling"]) == ("none", "engine")


@pytest.mark.parametrize(
    ("content", "code"),
    [("{}", "FILE_NOT_RECOGNISED"), ("[", "FILE_NOT_RECOGNISED"), (None, "FILE_NOT_FOUND")],
)
def test_a_record_that_cannot_be_read_ends_the_command(
    here: Here, demo_asset: Path, tmp_path: Path, content: str | None, code: str
) -> None:
    if content is not None:
        (tmp_path / "bad.json").write_text(content)
    here("bench", "--compare", tmp_path / "bad.json", demo_asset).ends(3, f"{code}: ")


def test_bench_rejects_modes_that_a_tier_does_not_have(here: Here, demo_asset: Path) -> None:
    for option, value in (("--order", "tile"), ("--sampling", "engine")):
        here("bench", option, value, demo_asset).ends(4, "UNSUPPORTED_OPTION: ")
