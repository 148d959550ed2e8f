"""The camera's float32 matrices equal the matrices that official code passes to its kernels."""

import numpy as np
import pytest

from msb.methods.diffsoup.reference import diffsoup_projection
from msb.reference.camera_matrices import splatting_camera
from msb.scenes import Camera
from tests.reference.golden import View, golden_views, names

SPLATTING = [*golden_views("two_dts"), *golden_views("triangle_splatting")]


@pytest.mark.parametrize("view", SPLATTING, ids=names)
def test_full_projection_is_official_bit_for_bit(view: View) -> None:
    stored = view.stored
    name, planes = (
        ("full_proj", (1.0, 1000.0)) if "full_proj" in stored else ("full_projection", (0.01, 100.0))
    )
    matrices = splatting_camera(view.camera, *planes, np.float32)
    np.testing.assert_array_equal(matrices.full_projection, stored[name])
    np.testing.assert_array_equal(matrices.world_to_camera, stored["world_to_camera"])
    half = [float(stored[name]) / 2 for name in ("fovx", "fovy")]
    np.testing.assert_array_equal(matrices.tan_fov, np.tan(half).astype(np.float32))
    np.testing.assert_array_equal(matrices.shift, [0, 0])
    # Official code inverts in float32, and its library decides the last bits. Our code inverts in float64 and
    # rounds once.
    offset = max(1, np.linalg.norm(stored["world_to_camera"][:3, 3]))
    np.testing.assert_allclose(matrices.center, stored["camera_center"], atol=3e-7 * offset, rtol=0)


@pytest.mark.parametrize("view", golden_views("diffsoup"), ids=names)
def test_diffsoup_mvp_is_official_bit_for_bit(view: View) -> None:
    layout = "synthetic" if "c2w" in view.stored else "colmap"
    planes = view.settings["z_near"], view.settings["z_far"]
    mvp, inverse = diffsoup_projection(view.camera, layout, *planes, np.float32)
    np.testing.assert_array_equal(mvp, view.stored["mvp"])
    np.testing.assert_allclose(inverse, view.stored["mvp_inv"], atol=2e-5 * np.abs(inverse).max())


def test_a_supersampled_raster_keeps_the_angles() -> None:
    camera = Camera(64, 48, 70, 75, 30, 25, np.eye(4))
    single, four = (splatting_camera(camera, 0.01, 100.0, np.float64, scale) for scale in (1, 4))
    assert (four.width, four.height) == (256, 192)
    np.testing.assert_array_equal(single.full_projection, four.full_projection)
    np.testing.assert_array_equal(single.shift, [-2, 1])
    np.testing.assert_array_equal(four.shift, [-8, 4])
