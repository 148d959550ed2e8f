"""Device memory by purpose: renderers name the group of each buffer where they make it."""

from collections import Counter

import numpy as np
import pytest

import msb
from msb.cl import open_device
from msb.render.backend import check_supported, find_renderer
from msb.render.device_scope import DeviceScope
from msb.scenes.datasets import read_scene
from tests.tiny import MODELS, SCENES


@pytest.mark.slow
@pytest.mark.parametrize("style", ["cpu", "gpu"])
@pytest.mark.parametrize("method", ["two_dts", "mesh_splatting", "diffsoup"])
def test_every_renderer_says_what_its_memory_is_for(method: str, style: str) -> None:
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


def test_a_new_buffer_is_counted_by_what_is_said_where_it_is_made() -> None:
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
