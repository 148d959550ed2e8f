"""The official Triangle-Splatting kernels' images, alphas, depths, normals and kept triangles."""

import numpy as np
import pytest

from tests.reference.golden import View, golden_views, names, psnr, worst

VIEWS = golden_views("triangle_splatting")


def visible(view: View) -> np.ndarray:
    return np.unpackbits(view.stored["visible"], count=len(view.frame.visible)).astype(bool)


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float32_repeats_the_official_kernels(view: View) -> None:
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
@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float64_differs_at_single_edge_pixels(view: View) -> None:
    frame = view.render(np.float64)
    off = np.abs(frame.image - view.image).max(axis=-1)
    assert psnr(frame.image, view.image) >= 60
    assert (off > 1e-3).sum() <= 4
    np.testing.assert_array_equal(frame.visible, visible(view))


def test_the_view_direction_of_the_centroid_is_another_image() -> None:
    """Trained coefficients are right with the official kernel's broadcast of z alone."""
    view = VIEWS[0]
    assert 10 < psnr(view.render(view_dir="centroid").image, view.image) < 35
