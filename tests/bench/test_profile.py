"""`msb bench` and the timing of runs: percentiles, warm-up, memory, and the cost of a single triangle."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.bench.aggregate import METRICS
from msb.bench.floor import take_one_triangle
from msb.bench.parts import group_memory
from msb.bench.profile import profile
from msb.bench.records import Timing
from msb.render.backend import SETTLED_AT, DrawTime
from msb.scenes import turntable, write_cameras
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS
from tests.cli.conftest import Here
from tests.report.factory import result, timing

SPANS = ("p50_ms", "p95_ms", "mean_ms", "busy_p50_ms", "busy_p95_ms")


class FakeRenderer:
    """Reports 1, 2, 3, ... ms for its frames, and remembers the cameras."""

    def __init__(self) -> None:
        self.drawn: list[Any] = []

    def draw(self, camera: Any, background: Any) -> DrawTime:
        self.drawn.append(camera)
        number = len(self.drawn)
        time.sleep(0.0005)
        return DrawTime({"raster": float(number), "shade": 1.0}, number + 1.5, number + 2.0)

    def memory(self) -> dict[str, int]:
        settled = len(self.drawn) >= SETTLED_AT
        return {"geometry": 100, "scratch": 5 + settled, "lists": max(map(ord, self.drawn))}

    def memory_groups(self) -> dict[str, str]:
        return {}

    def render(self, *_: Any) -> None:
        pytest.fail("a timing must not read images back")


def test_percentiles_are_interpolated_without_the_warm_up() -> None:
    renderer, steps = FakeRenderer(), []
    result = profile(renderer, ["a", "b", "c"], frames=20, seconds=0, step=lambda: steps.append(1))
    warm = len(renderer.drawn) - 20
    assert warm == 10
    spans = np.arange(warm + 1, warm + 21) + 1.5
    timing = result.timing
    assert timing.frames == 20 == len(steps)
    assert (timing.p50_ms, timing.p95_ms) == tuple(np.percentile(spans, (50, 95)))
    assert (timing.p50_ms, timing.p95_ms) == tuple(np.percentile(timing.frame_ms, (50, 95)))
    assert timing.frame_ms == tuple(spans)
    assert timing.busy_p50_ms == pytest.approx(timing.p50_ms - 0.5)
    assert timing.queued_p50_ms == pytest.approx(timing.p50_ms + 0.5)
    assert len(timing.round_fps) == 5
    assert min(timing.round_fps) <= timing.fps <= max(timing.round_fps)
    assert timing.stages_ms == {"raster": np.median(spans) - 1.5, "shade": 1.0}
    assert result.memory == {"geometry": 100, "scratch": 6, "lists": ord("c")}
    assert 1000 / timing.fps >= 0.5, "each frame sleeps for half a millisecond"


def test_a_record_keeps_the_times_of_evenly_spread_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("msb.bench.profile.MOST_FRAME_TIMES", 5)
    timing = profile(FakeRenderer(), ["a"], frames=10, seconds=0, warm_up=0).timing
    assert timing.frame_ms == (2.5, 4.5, 6.5, 8.5, 10.5)
    changed = {**timing.model_dump(), "frame_ms": [1.0] * 10}
    with pytest.raises(ValueError, match="frame_ms"):
        Timing(**changed)


def test_cameras_alternate_until_frames_and_seconds_are_reached() -> None:
    renderer = FakeRenderer()
    result = profile(renderer, ["a", "b"], frames=1, seconds=0.5)
    timed = renderer.drawn[1:]
    assert timed[:4] == ["a", "b", "a", "b"]
    assert len(renderer.drawn) == 1 + result.timing.frames
    assert len(timed) > 5
    with pytest.raises(ValueError, match="cameras is empty"):
        profile(renderer, [], frames=1)


@pytest.mark.parametrize(("frames", "warm_up"), [(1, 0), (2, 0), (2, 1), (1, 3), (9, 4), (4, None)])
def test_memory_covers_every_camera_of_a_settled_renderer(frames: int, warm_up: int | None) -> None:
    for cameras in ("a", "abc", "cba", "abcdefgh"):
        result = profile(FakeRenderer(), cameras, frames=frames, seconds=0, warm_up=warm_up)
        assert result.timing.frames == frames
        assert result.memory == {"geometry": 100, "scratch": 6, "lists": ord(max(cameras))}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["triangle_splatting", "mesh_splatting"])
def test_memory_does_not_depend_on_the_number_of_timed_frames(method: str) -> None:
    scene = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble")
    asset, memory = msb.export(PEBBLE / method), []
    for warm_up in (0, 1, 10):
        with msb.Renderer(asset, tier="dedicated") as renderer:
            timed = profile(renderer, scene.test, scene.background, frames=1, seconds=0, warm_up=warm_up)
        memory.append(timed.memory)
    assert memory[0] == memory[1] == memory[2]


def test_memory_of_an_unknown_use_is_scratch() -> None:
    memory = group_memory({"vulkan heap": 5, "positions": 7}, {"positions": "geometry"})
    assert (memory.scratch, memory.geometry, memory.total) == (5, 7, 12)
    assert memory.uses == {"vulkan heap": 5, "positions": 7}


@pytest.mark.parametrize("method", ["two_dts", "triangle_splatting", "mesh_splatting", "diffsoup"])
def test_one_triangle_keeps_all_buffers_of_the_first_triangle(method: str) -> None:
    whole = msb.export(PEBBLE / method)
    single = take_one_triangle(whole)
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
def test_bench_writes_and_compares_records(
    here: Here, demo_asset: Path, cameras: Path, tmp_path: Path
) -> None:
    record = tmp_path / "old.json"
    args = ("bench", "--cameras", cameras, "--repeat", "4", "--seconds", "0")
    assert here(*args, "--json", record, demo_asset).status == 0
    data = json.loads(record.read_text())
    assert data["schema"] == "msb.bench/1"
    assert (data["frames"], data["memory_views"]) == (4, data["views"])
    assert data["machine"]["device"]["platform"]
    assert 0 < data["device_ms"]["p50"] <= data["device_ms"]["p95"]
    assert sum(data["memory_bytes"].values()) > msb.load(demo_asset).buffers["indices"].nbytes
    assert sum(data["stages_ms"].values()) <= 2 * data["device_ms"]["p95"]
    assert here(*args, "--compare", record, demo_asset).status == 0
    fast = {**data, "device_ms": {**data["device_ms"], "p50": data["device_ms"]["p50"] / 1000}, "faces": 1}
    (tmp_path / "fast.json").write_text(json.dumps(fast))
    result = here(*args, "--compare", tmp_path / "fast.json", "--fail-slower", "900%", demo_asset)
    note, failure = result.err.splitlines()
    assert result.status == 1
    assert "34761" in note, "the numbers of faces differ"
    assert failure.startswith("GATE_FAILED: ")
    here(*args, "--compare", record, "--fail-slower", "ten", demo_asset).ends(2, "USAGE: --fail-slower")
    modes = ("--tier", "dedicated", "--order", "none", "--sampling", "engine")
    data = here(*args, *modes, "--json", "-", demo_asset).json
    assert (data["order"], data["sampling"]) == ("none", "engine")


class NumpyRenderer:
    """A renderer of another package that draws on the host and measures no times."""

    name, version = "numpy-only", "1"

    def __init__(self, _asset: Any, **_: Any) -> None:
        pass

    def render(self, camera: Any, background: Any) -> msb.Frame:
        image = np.full((camera.height, camera.width, 3), background, np.float32)
        return msb.Frame(image=image, alpha=image[..., 0], depth=image[..., 0])

    def memory(self) -> dict[str, int]:
        return {}

    def close(self) -> None:
        pass


@pytest.mark.parametrize("draws", [False, True])
def test_a_renderer_without_device_times_has_no_device_and_no_zeros(
    here: Here, demo_asset: Path, cameras: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, draws: bool
) -> None:
    if draws:
        monkeypatch.setattr(NumpyRenderer, "draw", lambda *_: DrawTime({}, 0.0), raising=False)
    place = f"{__name__}:NumpyRenderer"
    monkeypatch.setattr("msb.render.backend.renderers", lambda: {"numpy-only": place})
    args = ("bench", "--renderer", "numpy-only", "--cameras", cameras, "--repeat", "3", "--seconds", "0")
    old = tmp_path / "old.json"
    result = here(*args, "--json", old, demo_asset)
    assert result.status == 0
    data = json.loads(old.read_text())
    assert "device" not in data["machine"]
    assert set(data["device_ms"].values()) == {None} == set(data["busy_ms"].values())
    assert data["fps"] > 0
    printed = here(*args, "--compare", old, demo_asset)
    assert printed.status == 0
    rows = [line.split() for line in printed.out.splitlines() if line.startswith(("device time", "memory"))]
    assert [row[-3:] for row in rows] == [["--", "--", "-"]] * 3
    here(*args, "--compare", old, "--fail-slower", "5%", "--json", "-", demo_asset, status=2)


def test_tables_have_no_device_times_of_a_renderer_that_measures_none() -> None:
    record = result(timing=timing(**dict.fromkeys(SPANS, 0.0)))
    names = ("p50_ms", "p95_ms", "spread_ms", "busy_p50_ms", "host_ms")
    assert [METRICS[name].get(record) for name in names] == [None] * 5
    assert METRICS["fps"].get(record) == 100


@pytest.mark.parametrize(
    ("content", "code"),
    [("{}", "FILE_NOT_RECOGNISED"), ("[", "FILE_NOT_RECOGNISED"), (None, "FILE_NOT_FOUND")],
)
def test_an_invalid_record_to_compare_with_ends_the_command(
    here: Here, demo_asset: Path, tmp_path: Path, content: str | None, code: str
) -> None:
    if content is not None:
        (tmp_path / "bad.json").write_text(content)
    here("bench", "--compare", tmp_path / "bad.json", demo_asset).ends(3, f"{code}: ")


def test_bench_rejects_unsupported_modes(here: Here, demo_asset: Path) -> None:
    for option, value in (("--order", "tile"), ("--sampling", "engine")):
        here("bench", option, value, demo_asset).ends(4, "UNSUPPORTED_OPTION: ")
