"""Leaving faces out on the device draws what a mesh without them does."""

from contextlib import closing

import numpy as np
import pytest

from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from msb.why.views import _Culling


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_faces_that_are_left_out_are_as_if_they_were_not_there(dtype: type) -> None:
    random = np.random.default_rng(4)
    count = 50  # neither a whole block nor a whole cluster
    vertices = random.uniform(-1, 1, (3 * count, 3)).astype(np.float32)
    colors = (random.random((3 * count, 3)) * (255 if dtype is np.uint8 else 1)).astype(dtype)
    faces = np.arange(3 * count).reshape(-1, 3)
    camera = Camera.look_at((0, 0, -4), (0, 0, 0), width=64, height=48, fov_y=0.8)
    with closing(_Culling(asset_from_mesh(Mesh(vertices, faces, colors)), None)) as renderer:
        for share in (0.5, 0.2):
            shown = random.random(count) < share
            renderer.show(shown)
            rest = asset_from_mesh(Mesh(vertices, faces[shown], colors))
            with closing(StandardRenderer(rest)) as alone:
                np.testing.assert_array_equal(renderer.render_image(camera), alone.render_image(camera))
                assert alone.render_image(camera).any()
