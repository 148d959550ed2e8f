"""The splatting pipeline against results of the official kernels, in both kernel styles."""

from typing import Any

import numpy as np
import pytest

from msb.cl import Device
from msb.render.frame import Frame
from msb.render.splat.pipeline import SplattingPipeline
from tests.golden.views import compare
from tests.reference.golden import View, exported, golden_views, names, worst
from tests.render.frames import frame_of

VIEWS = [
    view for method in ("two_dts", "triangle_splatting", "mesh_splatting") for view in golden_views(method)
]
golden = pytest.mark.parametrize("view", VIEWS, ids=names)


def mark_slow(views: list[View]) -> list[Any]:
    """Return the parameters of a test; all but the first view of each scene are slow."""
    first = {view.folder: view for view in reversed(views)}
    return [
        pytest.param(view, marks=() if first[view.folder] is view else pytest.mark.slow, id=names(view))
        for view in views
    ]


GAUSSIANS = mark_slow([view for method in ("three_dgs", "two_dgs") for view in golden_views(method)])


def render_view(view: View, device: Device, outputs: Any = "all", **overrides: Any) -> Frame:
    options = {"settings": {**view.settings, **overrides}, "outputs": outputs}
    asset = exported(view.folder / "checkpoint")
    return frame_of(SplattingPipeline, asset, device, view.camera, view.background, **options)


@golden
def test_images_are_the_official_ones(view: View, device: Device) -> None:
    frame, stored = render_view(view, device), view.stored
    psnr, share = compare(frame.image, view.image, view.stable)
    assert share <= 1e-3
    assert psnr >= 120
    for name in {"alpha", "transmittance", "depth", "depth_accum", "depth_median", "normal", "normal_accum"}:
        if name in stored and name in frame.raw:
            assert frame.raw[name].shape == stored[name].shape
            off = np.abs(frame.raw[name].astype(np.float64) - stored[name]) > 2e-3
            assert off.mean() <= 1e-3, name
    if "radii" in stored:
        np.testing.assert_array_equal(frame.visible, stored["radii"] > 0)
    if "visible" in stored:
        np.testing.assert_array_equal(np.packbits(frame.visible), stored["visible"])
    if "faces_kept_ss4" in stored:
        assert frame.visible.sum() == stored["faces_kept_ss4"]
        assert worst(frame.alpha[view.stable], stored["alpha"][view.stable]) <= 1e-4


@pytest.mark.parametrize("view", GAUSSIANS)
def test_images_of_gaussians_are_those_of_gsplat(view: View, device: Device) -> None:
    frame = render_view(view, device)
    psnr, share = compare(frame.image, view.image, view.stable)
    assert share == 0
    assert psnr >= 100


@pytest.mark.parametrize("view", GAUSSIANS)
def test_gaussians_follow_the_official_rules(view: View, device: Device) -> None:
    """Of the official rules there is only our reference."""
    frame = render_view(view, device, rasterizer="official")
    wanted = view.render(rasterizer="official")
    psnr, share = compare(frame.image, wanted.image)
    assert share == 0
    assert psnr >= 110
    np.testing.assert_array_equal(frame.visible, wanted.visible)
    for name in ("depth", "depth_median", "normal"):
        values, expected = getattr(frame, name), getattr(wanted, name)
        assert (values is None) == (expected is None)
        if values is not None:
            assert (np.abs(values - expected) > 5e-3).mean() <= 1e-3, name


@pytest.mark.parametrize("view", [v for v in VIEWS if "ss1_image" in v.stored], ids=names)
def test_single_samples_are_the_official_ones(view: View, device: Device) -> None:
    frame, stored = render_view(view, device, supersample=1), view.stored
    stable = stored["ss1_stable"]
    psnr, share = compare(frame.image, stored["ss1_image"], stable)
    assert share <= 1e-3
    assert psnr >= 100
    assert frame.visible.sum() == stored["faces_kept_ss1"]
    for name in ("alpha", "depth_expected", "depth_median", "normal_cam"):
        if f"ss1_{name}" in stored:
            off = np.abs(frame.raw[f"ss1_{name}"].astype(np.float64) - stored[f"ss1_{name}"]) > 2e-3
            assert (off[stable]).mean() <= 1e-3, name
    assert (frame.raw["ss1_face_id"] != stored["ss1_face_id"])[stable].mean() <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("view", [VIEWS[0], VIEWS[3], VIEWS[11], VIEWS[20]], ids=names)
def test_outputs_do_not_change_the_image(view: View, device: Device) -> None:
    """Other kernels are used if outputs besides image, alpha and depth are requested."""
    few, all_of_them = render_view(view, device, ()), render_view(view, device)
    for name in ("image", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(few, name), getattr(all_of_them, name))
    assert few.normal is few.depth_median is few.face_id is None
    assert not few.raw
