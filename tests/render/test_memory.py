"""Device memory: counted by purpose, and clear errors for scenes that do not fit."""

import dataclasses
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.cl import Device, open_device, shared_device
from msb.errors import DeviceError
from msb.render.backend import check_supported, find_renderer
from msb.render.dedicated import dedicated_renderer
from msb.render.device_scope import DeviceScope
from msb.render.splat import pipeline as splatting
from msb.scenes.datasets import read_scene
from tests.cl.conftest import SELECTOR, open_styled
from tests.reference.soups import METHODS, SPLATTING, front_camera, random_triangles, soup
from tests.render.frames import frame_of
from tests.tiny import MODELS, SCENES

CAMERA = front_camera(90, 60)
BLACK = (0.0, 0.0, 0.0)


@pytest.fixture(params=["cpu", "gpu"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    with open_styled(request.param) as opened:
        yield opened


def limit(device: Device, **changes: int) -> None:
    """Reduce the memory that `device` reports."""
    device._queue.record = dataclasses.replace(device.record, **changes)


def model(method: str, faces: int = 600) -> Asset:
    return soup(method, random_triangles(1, faces, 0.5), degree=0 if method == "diffsoup" else 3)


def draw(asset: Asset, device: Device, outputs: Any = "all") -> tuple[dict[str, int], dict[str, int]]:
    """Draw a frame; return the bytes by purpose, of the model and of the frame."""
    renderer = dedicated_renderer(asset, device=device, outputs=outputs)
    try:
        model = device.memory()
        renderer.render(CAMERA, BLACK)
        return model, {use: size for use, size in device.memory().items() if use not in model}
    finally:
        renderer.close()


def rejection(asset: Asset, device: Device) -> tuple[DeviceError | None, str]:
    """Return the error for an asset that does not fit, and the purpose of the buffer that failed."""
    try:
        draw(asset, device)
    except DeviceError as error:
        figure, _, use = error.message.partition(" do not fit: ")[0].partition(" MiB for ")
        return (error if float(figure.replace(",", "")) >= 0 else None), use
    return None, ""


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_buffers_that_do_not_fit_are_named(method: str, device: Device) -> None:
    """As memory grows, the model, projected faces, lists, samples and pixels fail in turn."""
    asset, whole = model(method), device.record.global_memory
    _, frame = draw(asset, device)
    uses = set()
    for step in np.linspace(0, 0.98 * sum(frame.values()), 14, dtype=int).tolist():
        limit(device, global_memory=step)
        error, use = rejection(asset, device)
        assert error.code == "DEVICE_MEMORY"
        assert f" has {step / 2**20:,.1f} MiB, " in error.message
        uses.add(use)
        assert device.memory() == {}  # everything was released
    assert len(uses) >= 4
    assert {"positions"} < uses
    assert any(use.startswith(("splat ", "lattice ")) for use in uses)
    limit(device, global_memory=whole)
    draw(asset, device)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("faces", [20, 20_000], ids=["few", "many"])
def test_no_buffer_is_larger_than_the_device_takes_at_once(method: str, faces: int, device: Device) -> None:
    """A large model does not fit. If the model is small, a buffer of the frame does not fit."""
    asset = model(method, faces)
    model_memory, frame = draw(asset, device)
    largest = max(frame.values())
    limit(device, max_allocation=largest // 2)
    error, use = rejection(asset, device)
    assert f"at most {largest / 2**21:,.1f} MiB" in error.message
    assert (use in model_memory) == (faces == 20_000)


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
def test_samples_are_drawn_in_bands_that_fit(
    method: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drawing in bands gives the same image. Only raw buffers need the whole raster at once."""
    asset = model(method, 20)
    wanted = frame_of(dedicated_renderer, asset, device, CAMERA, BLACK, outputs=("normal",))
    monkeypatch.setattr(splatting, "_BAND_BYTES", {"cpu": 1 << 16, "gpu": 1 << 16})
    needed = 10 * 4 * 96 * 64 * (16 if method == "mesh_splatting" else 1)
    limit(device, max_allocation=needed // 2)
    frame = frame_of(dedicated_renderer, asset, device, CAMERA, BLACK, outputs=("normal",))
    for name in ("image", "depth", "normal"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(wanted, name))
    with pytest.raises(DeviceError, match="splat planes"):
        draw(asset, device)


@pytest.mark.slow
@pytest.mark.parametrize("style", ["cpu", "gpu"])
@pytest.mark.parametrize("method", ["two_dts", "mesh_splatting", "diffsoup"])
def test_every_renderer_reports_the_purpose_of_its_memory(method: str, style: str) -> None:
    asset = msb.export(MODELS / "pebble" / method)
    camera = read_scene(SCENES / "nerf_synthetic" / "pebble").test[0]
    for tier in ("standard", "dedicated"):
        try:
            check_supported(asset, tier)
        except msb.Unsupported:
            continue
        with open_device("cpu", style=style) as device:
            renderer = find_renderer(tier)(asset, device=device, settings={})
            renderer.render(camera, (0.0, 0.0, 0.0))
            uses, groups = device.memory(), renderer.memory_groups()
            renderer.close()
        assert uses.keys() == groups.keys()
        sums = Counter(dict.fromkeys(("geometry", "appearance", "scratch", "targets"), 0))
        for use, size in uses.items():
            sums[groups[use]] += size
        assert min(sums.values()) > 0
        assert sums["targets"] >= 4 * camera.width * camera.height * 4  # colour and depth


def test_buffers_are_counted_in_the_group_of_their_allocation() -> None:
    scope = DeviceScope(None, "some renderer")
    with scope.setting_up():
        scope.scratch("second image", 64, group="targets")
        scope.scratch("list of something", 128)
        scope.keep("normals", np.zeros(16, np.float32))
    sizes, groups = scope.memory(), scope.memory_groups()
    assert {groups[use]: size for use, size in sizes.items()} == {
        "targets": 256,
        "scratch": 512,
        "geometry": 64,
    }
    scope.close()


THREADS, FRAMES = 8, 48
SMALL, LARGE = front_camera(40, 30), front_camera(160, 120)
TIERS = ("standard", "dedicated")


@pytest.fixture(scope="module")
def asset() -> Asset:
    return soup("two_dts", random_triangles(1, 400, 0.5), degree=1)


def image_bytes(renderer: msb.Renderer, number: int) -> bytes:
    camera = (SMALL, LARGE)[number % 2]
    return renderer.render(camera, background=(1, 1, 1)).image.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_eight_threads_may_draw_with_one_renderer(asset: Asset, tier: Any) -> None:
    with msb.Renderer(asset, tier=tier, device=SELECTOR) as renderer:
        wanted = [image_bytes(renderer, number) for number in range(2)]
        with ThreadPoolExecutor(THREADS) as pool:
            frames = list(pool.map(lambda number: image_bytes(renderer, number), range(FRAMES)))
    assert frames == wanted * (FRAMES // 2)


@pytest.mark.parametrize("tier", TIERS)
@pytest.mark.slow
def test_memory_counts_only_the_renderer_itself(asset: Asset, tier: Any) -> None:
    """Memory of other renderers on the same device does not count."""

    def memory_after_small(renderer: msb.Renderer) -> dict[str, int]:
        image_bytes(renderer, 0)
        return dict(renderer.memory())

    with msb.Renderer(asset, tier=tier, device=SELECTOR) as alone:
        wanted = memory_after_small(alone)
    with msb.Renderer(asset, tier=tier, device=SELECTOR) as large:
        image_bytes(large, 1)
        with msb.Renderer(asset, tier=tier, device=SELECTOR) as small:
            assert memory_after_small(small) == wanted
            image_bytes(large, 1)
            assert dict(small.memory()) == wanted


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_renderers_leave_nothing_on_the_device(asset: Asset, tier: Any) -> None:
    """Closing releases buffers and programs, because PoCL keeps a megabyte per program and context."""
    device = shared_device(SELECTOR)
    msb.render(asset, SMALL, tier=tier, device=SELECTOR)
    held, programs = device.memory(), len(device._programs)
    for _ in range(20):
        msb.render(asset, SMALL, tier=tier, device=SELECTOR)
        with msb.Renderer(asset, tier=tier, device=SELECTOR) as renderer:
            image_bytes(renderer, 0)
    assert shared_device(SELECTOR) is device
    assert (device.memory(), len(device._programs)) == (held, programs)


@pytest.mark.parametrize("tier", TIERS)
def test_a_closed_renderer_raises_device_closed(asset: Asset, tier: Any) -> None:
    renderer = msb.Renderer(asset, tier=tier, device=SELECTOR)
    renderer.close()
    renderer.close()
    for call in (renderer.render, renderer.draw):
        with pytest.raises(DeviceError, match="the renderer was closed") as error:
            call(SMALL)
        assert error.value.code == "DEVICE_CLOSED"
    assert sum(renderer.memory().values()) == 0
