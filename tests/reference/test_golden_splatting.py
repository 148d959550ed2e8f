"""The references of the splatting methods against official images, depths, normals and kept faces."""

import numpy as np
import pytest

from msb.methods.mesh_splatting.reference import box_mean
from tests.reference.golden import View, golden_views, names, psnr, worst

TWO_DTS = golden_views("two_dts")


@pytest.mark.parametrize("view", TWO_DTS, ids=names)
def test_float32_repeats_the_official_kernels_of_two_dts(view: View) -> None:
    frame, stored = view.frame, view.stored
    assert frame.image.dtype == np.float32
    assert psnr(frame.image, view.image) >= 140
    assert worst(frame.image, view.image) <= 1e-6
    assert worst(frame.raw["transmittance"], stored["transmittance"]) <= 2e-7
    assert worst(frame.raw["depth"], stored["depth"]) <= 1e-5
    assert frame.raw["bg_depth"] == pytest.approx(stored["bg_depth"], rel=3e-7)
    if "radii" in stored:
        np.testing.assert_array_equal(frame.raw["radii"], stored["radii"])
        np.testing.assert_array_equal(frame.visible, stored["radii"] > 0)
        assert worst(frame.raw["normal"], stored["normal"]) <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("view", TWO_DTS, ids=names)
def test_float64_differs_by_rounding(view: View) -> None:
    frame = view.render(np.float64)
    assert frame.image.dtype == np.float64
    assert psnr(frame.image, view.image) >= 85
    assert worst(frame.image, view.image) <= 5e-3
    if "radii" in view.stored:
        np.testing.assert_array_equal(frame.visible, view.stored["radii"] > 0)


@pytest.mark.parametrize("view", TWO_DTS, ids=names)
def test_depth_equals_the_official_depth_without_background(view: View) -> None:
    """With one sample per pixel, official buffers are enough to compute the expected depth."""
    if view.settings["render_up_scale"] > 1:
        assert view.frame.raw["depth"].shape == tuple(2 * side for side in view.frame.depth.shape)
        return
    transmittance = view.stored["transmittance"].astype(np.float64)
    accumulated = view.stored["depth"] - transmittance * view.stored["bg_depth"]
    seen = transmittance < 0.9
    expected = accumulated[seen] / (1 - transmittance[seen])
    np.testing.assert_allclose(view.frame.depth[seen], expected, rtol=2e-4, atol=1e-4)
    assert (view.frame.depth[transmittance == 1] == 0).all()


TRIANGLES = golden_views("triangle_splatting")


def visible(view: View) -> np.ndarray:
    return np.unpackbits(view.stored["visible"], count=len(view.frame.visible)).astype(bool)


@pytest.mark.parametrize("view", TRIANGLES, ids=names)
def test_float32_repeats_the_official_kernels_of_triangle_splatting(view: View) -> None:
    frame, stored = view.frame, view.stored
    assert psnr(frame.image, view.image) >= 140
    assert worst(frame.image, view.image) <= 1e-6
    assert worst(frame.alpha, stored["alpha"]) <= 3e-7
    assert worst(frame.raw["depth_accum"], stored["depth_accum"]) <= 3e-6
    np.testing.assert_array_equal(frame.visible, visible(view))
    if "depth_median" in stored:
        np.testing.assert_array_equal(frame.depth_median, stored["depth_median"])
        assert worst(frame.normal, stored["normal_accum"]) <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("view", TRIANGLES, ids=names)
def test_float64_differs_at_single_pixels(view: View) -> None:
    frame = view.render(np.float64)
    off = np.abs(frame.image - view.image).max(axis=-1)
    assert psnr(frame.image, view.image) >= 60
    assert (off > 1e-3).sum() <= 4
    np.testing.assert_array_equal(frame.visible, visible(view))


def test_the_view_direction_of_the_centroid_changes_the_image() -> None:
    """Trained coefficients are correct only with the official kernel's broadcast of z."""
    view = TRIANGLES[0]
    assert 10 < psnr(view.render(view_dir="centroid").image, view.image) < 35


MESHES = golden_views("mesh_splatting")


@pytest.mark.slow
@pytest.mark.parametrize("view", MESHES, ids=names)
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


@pytest.mark.parametrize("view", MESHES, ids=names)
def test_float32_repeats_every_plane_of_the_raster(view: View) -> None:
    """The buffers ss1_* are the rasterizer's planes with one sample per pixel."""
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
@pytest.mark.parametrize("view", MESHES, ids=names)
def test_float64_differs_at_single_edge_pixels(view: View) -> None:
    """At most 0.5 % of the stable pixels differ; the telephoto view is the worst."""
    frame, stored = view.render(np.float64, supersample=1), view.stored
    off = np.abs(frame.image - stored["ss1_image"]).max(axis=-1)[stored["ss1_stable"]]
    assert psnr(frame.image, stored["ss1_image"]) >= 50
    assert (off > 1e-3).mean() <= 0.005
    assert frame.raw["faces_kept_ss1"] == stored["faces_kept_ss1"]
    assert (frame.face_id != stored["ss1_face_id"]).sum() <= 1


@pytest.mark.slow
def test_float64_supersampled() -> None:
    view = MESHES[3]
    frame = view.render(np.float64)
    assert psnr(frame.image, view.image) >= 60
    assert frame.raw["faces_kept_ss4"] == view.stored["faces_kept_ss4"]
