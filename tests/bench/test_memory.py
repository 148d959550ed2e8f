"""Every use of device memory our renderers name belongs to a group."""

from __future__ import annotations

import pytest

import msb
from msb.bench.memory import group_of, grouped
from msb.cl import open_device
from msb.render.protocol import check_supported, find_renderer
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS

METHODS = ("two_dts", "mesh_splatting", "diffsoup")
"""Triangle-Splatting has the pipeline of 2DTS."""


@pytest.mark.parametrize("style", ["cpu", "gpu"])
@pytest.mark.parametrize("method", METHODS)
def test_every_use_is_mapped(method: str, style: str) -> None:
    asset = msb.export(PEBBLE / method)
    camera = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble").test[0]
    for tier in ("standard", "dedicated"):
        try:
            check_supported(asset, tier)
        except msb.Unsupported:
            continue
        with open_device("cpu", style=style) as device:  # type: ignore[arg-type]
            renderer = find_renderer(tier)(asset, device=device, settings={})
            renderer.render(camera, (0.0, 0.0, 0.0))
            uses = device.memory()
            renderer.close()
        assert {use: group_of(use) for use in uses if group_of(use) is None} == {}
        found = grouped(uses)
        assert found.total == sum(uses.values())
        assert min(found.geometry, found.appearance, found.scratch, found.targets) > 0
        pixels = camera.width * camera.height
        assert found.targets >= 4 * pixels * 4  # colour and depth


def test_what_is_unknown_is_scratch() -> None:
    found = grouped({"vulkan heap": 5, "positions": 7})
    assert (found.scratch, found.geometry, found.total) == (5, 7, 12)
    assert found.uses == {"vulkan heap": 5, "positions": 7}
