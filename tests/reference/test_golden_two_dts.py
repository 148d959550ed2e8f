"""The official 2DTS kernels' images, transmittances, depths, normals and radii."""

import numpy as np
import pytest

from tests.reference.golden import View, golden_views, names, psnr, worst

VIEWS = golden_views("two_dts")


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float32_repeats_the_official_kernels(view: View) -> None:
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
@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float64_differs_by_rounding(view: View) -> None:
    frame = view.render(np.float64)
    assert frame.image.dtype == np.float64
    assert psnr(frame.image, view.image) >= 85
    assert worst(frame.image, view.image) <= 5e-3
    if "radii" in view.stored:
        np.testing.assert_array_equal(frame.visible, view.stored["radii"] > 0)


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_depth_is_that_of_the_kernel_without_its_background(view: View) -> None:
    """On rasters of one sample a pixel the expected depth follows from what the kernel stored."""
    if view.settings["render_up_scale"] > 1:
        assert view.frame.raw["depth"].shape == tuple(2 * side for side in view.frame.depth.shape)
        return
    transmittance = view.stored["transmittance"].astype(np.float64)
    accumulated = view.stored["depth"] - transmittance * view.stored["bg_depth"]
    seen = transmittance < 0.9
    expected = accumulated[seen] / (1 - transmittance[seen])
    np.testing.assert_allclose(view.frame.depth[seen], expected, rtol=2e-4, atol=1e-4)
    assert (view.frame.depth[transmittance == 1] == 0).all()
