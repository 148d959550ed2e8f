"""A scene that does not fit on the device is refused with the figure, whatever it is that does not fit."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset
from msb.cl import Device
from msb.errors import DeviceError
from msb.render.dedicated import dedicated_renderer
from msb.render.splat import pipeline as splatting
from tests.cl.conftest import open_styled
from tests.reference.soups import METHODS, SPLATTING, front_camera, random_triangles, soup

CAMERA = front_camera(90, 60)
BLACK = (0.0, 0.0, 0.0)


@pytest.fixture(params=["cpu", "gpu"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    with open_styled(request.param) as opened:
        yield opened


def limit(device: Device, **changes: int) -> None:
    """Make `device` one of less memory."""
    device._queue.record = dataclasses.replace(device.record, **changes)


def model(method: str, faces: int = 600) -> Asset:
    return soup(method, random_triangles(1, faces, 0.5), degree=0 if method == "diffsoup" else 3)


def draw(asset: Asset, device: Device, outputs: Any = "all") -> tuple[dict[str, int], dict[str, int]]:
    """Draw a frame, and return what the model takes of the device, and what the frame takes beside it."""
    renderer = dedicated_renderer(asset, device=device, outputs=outputs)
    try:
        model = device.memory()
        renderer.render(CAMERA, BLACK)
        return model, {use: size for use, size in device.memory().items() if use not in model}
    finally:
        renderer.close()


def refused(asset: Asset, device: Device) -> tuple[DeviceError | None, str]:
    """Return why `asset` cannot be drawn, and for what there is no room."""
    try:
        draw(asset, device)
    except DeviceError as error:
        figure, _, use = error.message.partition(" do not fit: ")[0].partition(" MiB for ")
        return (error if float(figure.replace(",", "")) >= 0 else None), use
    return None, ""


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_whatever_does_not_fit_is_named(method: str, device: Device) -> None:
    """From no memory to enough: model, projected faces, lists, samples and pixels are met in turn."""
    asset, whole = model(method), device.record.global_memory
    _, frame = draw(asset, device)
    uses = set()
    for step in np.linspace(0, 0.98 * sum(frame.values()), 14, dtype=int).tolist():
        limit(device, global_memory=step)
        error, use = refused(asset, device)
        assert error.code == "DEVICE_MEMORY"
        assert f" has {step / 2**20:,.1f} MiB, " in error.message
        uses.add(use)
        assert device.memory() == {}  # nothing stays behind
    assert len(uses) >= 4
    assert {"positions"} < uses
    assert any(use.startswith(("splat ", "lattice ")) for use in uses)
    limit(device, global_memory=whole)
    draw(asset, device)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("faces", [20, 20_000], ids=["few", "many"])
def test_no_buffer_is_larger_than_the_device_takes_at_once(method: str, faces: int, device: Device) -> None:
    """Of a large model that is its own data, of a small one what a frame needs."""
    asset = model(method, faces)
    own, frame = draw(asset, device)
    largest = max(frame.values())
    limit(device, max_allocation=largest // 2)
    error, use = refused(asset, device)
    assert f"and takes at most {largest / 2**21:,.1f} at once" in error.message
    assert (use in own) == (faces == 20_000)


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
def test_samples_are_drawn_in_bands_that_fit(
    method: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only all of them at once (`raw`) may be too many."""
    monkeypatch.setattr(splatting, "_BAND_BYTES", {"cpu": 1 << 16, "gpu": 1 << 16})
    asset = model(method, 20)
    needed = 10 * 4 * 96 * 64 * (16 if method == "mesh_splatting" else 1)
    limit(device, max_allocation=needed // 2)
    draw(asset, device, outputs=("normal",))
    with pytest.raises(DeviceError, match="splat planes"):
        draw(asset, device)
