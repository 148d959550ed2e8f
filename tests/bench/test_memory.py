"""What device memory is for: renderers say it of each buffer where they make it."""

from __future__ import annotations

import numpy as np
import pytest

import msb
from msb.bench.parts import grouped
from msb.cl import open_device
from msb.render.backend import check_supported, find_renderer
from msb.render.device_scope import DeviceScope
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS

METHODS = ("two_dts", "mesh_splatting", "diffsoup")
"""Triangle-Splatting has the pipeline of 2DTS."""


@pytest.mark.slow
@pytest.mark.parametrize("style", ["cpu", "gpu"])
@pytest.mark.parametrize("method", METHODS)
def test_every_renderer_says_what_its_memory_is_for(method: str, style: str) -> None:
    asset = msb.export(PEBBLE / method)
    camera = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble").test[0]
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
        found = grouped(uses, groups)
        assert found.total == sum(uses.values())
        assert min(found.geometry, found.appearance, found.scratch, found.targets) > 0
        pixels = camera.width * camera.height
        assert found.targets >= 4 * pixels * 4  # colour and depth


def test_what_is_unknown_is_scratch() -> None:
    found = grouped({"vulkan heap": 5, "positions": 7}, {"positions": "geometry"})
    assert (found.scratch, found.geometry, found.total) == (5, 7, 12)
    assert found.uses == {"vulkan heap": 5, "positions": 7}


def test_a_new_buffer_is_counted_by_what_is_said_where_it_is_made() -> None:
    scope = DeviceScope(None, "some renderer")
    with scope.setting_up():
        scope.scratch("second image", 64, group="targets")
        scope.scratch("list of something", 128)
        scope.keep("normals", np.zeros(16, np.float32))
    found = grouped(scope.memory(), scope.memory_groups())
    assert (found.targets, found.scratch, found.geometry, found.appearance) == (256, 512, 64, 0)
    scope.close()
