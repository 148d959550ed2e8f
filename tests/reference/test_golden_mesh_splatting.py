"""The official MeshSplatting kernels' images, with and without supersampling, and their other planes."""

import numpy as np
import pytest

from msb.methods.mesh_splatting.reference import box_mean
from tests.reference.golden import View, golden_views, names, psnr, worst

VIEWS = golden_views("mesh_splatting")


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float32_repeats_the_official_kernels_supersampled(view: View) -> None:
    frame, stored = view.frame, view.stored
    assert psnr(frame.image, view.image) >= 130
    assert worst(frame.image, view.image) <= 2e-6
    assert worst(frame.alpha, stored["alpha"]) <= 3e-7
    assert frame.raw["faces_kept_ss4"] == frame.visible.sum() == stored["faces_kept_ss4"]
    np.testing.assert_array_equal(box_mean(frame.raw["ss4_image"], 4), frame.image)
    height, width = frame.alpha.shape
    assert frame.raw["ss4_face_id"].shape == (4 * height, 4 * width)
    np.testing.assert_array_equal(frame.face_id, frame.raw["ss4_face_id"][2::4, 2::4])


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float32_repeats_every_plane_of_the_raster(view: View) -> None:
    """The buffers ss1_* are the rasterizer's own, one sample a pixel."""
    frame, stored = view.render(supersample=1), view.stored
    assert psnr(frame.image, stored["ss1_image"]) >= 130
    assert frame.raw["faces_kept_ss1"] == stored["faces_kept_ss1"]
    np.testing.assert_array_equal(frame.raw["ss1_face_id"], stored["ss1_face_id"])
    np.testing.assert_array_equal(frame.raw["ss1_depth_median"], stored["ss1_depth_median"])
    np.testing.assert_array_equal(frame.face_id, stored["ss1_face_id"])
    for name in ("ss1_image", "ss1_alpha", "ss1_depth_expected", "ss1_normal_cam"):
        if name in stored:
            assert worst(frame.raw[name], stored[name]) <= 2e-6, name


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float64_differs_at_single_edge_pixels(view: View) -> None:
    """Suggested acceptance: 0.5 % of the stable pixels; the telephoto view is the worst."""
    frame, stored = view.render(np.float64, supersample=1), view.stored
    off = np.abs(frame.image - stored["ss1_image"]).max(axis=-1)[stored["ss1_stable"]]
    assert psnr(frame.image, stored["ss1_image"]) >= 50
    assert (off > 1e-3).mean() <= 0.005
    assert frame.raw["faces_kept_ss1"] == stored["faces_kept_ss1"]
    assert (frame.face_id != stored["ss1_face_id"]).sum() <= 1


@pytest.mark.slow
def test_float64_supersampled() -> None:
    view = VIEWS[3]
    frame = view.render(np.float64)
    assert psnr(frame.image, view.image) >= 60
    assert frame.raw["faces_kept_ss4"] == view.stored["faces_kept_ss4"]
