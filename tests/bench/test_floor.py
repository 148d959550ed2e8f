"""One triangle of a model is an asset that its renderers draw, and takes less than the model."""

import numpy as np
import pytest

import msb
from msb.bench.floor import one_triangle
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS


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
