"""DiffSoup through a graphics pipeline with a z-buffer, on whatever adapter there is."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.engines.hardware.renderer import HardwareRenderer
from msb.errors import MsbError
from msb.methods.diffsoup.look import Pipeline
from msb.methods.diffsoup.reference import pixel_boxes
from msb.render import Frame
from tests.engines.conftest import need
from tests.reference.golden import View, exported, golden_views, names, psnr
from tests.render.random_cases import draw_case

VIEWS = golden_views("diffsoup")

pytestmark = pytest.mark.oracle
every = pytest.mark.parametrize("view", VIEWS, ids=names)


@pytest.fixture(autouse=True)
def _needs_wgpu() -> None:
    need("wgpu")


def asset_of(view: View) -> Asset:
    return exported(view.folder / "checkpoint")


def drawn(make: Any, asset: Asset, view: Any, **options: Any) -> Frame:
    with closing(make(asset, settings=view.settings, **options)) as renderer:
        return renderer.render(view.camera, view.background)


def same_as_opencl(asset: Asset, view: View, **options: Any) -> Frame:
    """Hold a frame to that of our OpenCL: all but colours to the bit."""
    found = drawn(HardwareRenderer, asset, view, **options)
    equal(found, drawn(Pipeline, asset, view, outputs=(), **options))
    return found


def equal(found: Frame, wanted: Frame, within: float = 1e-5) -> None:
    for name in ("alpha", "depth", "visible"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    np.testing.assert_allclose(found.image, wanted.image, rtol=0, atol=within)


@pytest.mark.parametrize(
    "view",
    [pytest.param(view, marks=() if view is VIEWS[3] else pytest.mark.slow) for view in VIEWS],
    ids=names,
)
def test_every_golden_view_is_the_official_image(view: View) -> None:
    frame = same_as_opencl(asset_of(view), view)
    assert psnr(frame.image[view.stable], view.image[view.stable]) > 128


@pytest.mark.slow
@every
def test_triangles_across_the_camera_plane_are_clipped_as_in_opencl(view: View) -> None:
    same_as_opencl(asset_of(view), view, sampling="engine", order="none")


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS[::3], ids=names)
def test_bytes_of_the_web_export_are_drawn_as_in_opencl(view: View) -> None:
    same_as_opencl(view.web, view)


@pytest.mark.slow
@every
def test_rectangles_are_the_reference_s_bit_for_bit(view: View) -> None:
    asset = asset_of(view)
    clip = drawn(Pipeline, asset, view, outputs="all").raw["clip_corners"]
    dropped, boxes = pixel_boxes(clip, view.camera.width, view.camera.height)
    with HardwareRenderer(asset, settings=view.settings, debug=True) as renderer:
        renderer.draw(view.camera, (0, 0, 0))
        _, rectangles = renderer.decisions()
    kept = rectangles[:, 2] > 0
    np.testing.assert_array_equal(kept, ~dropped)
    np.testing.assert_array_equal(rectangles[kept], (boxes[:, [0, 2, 1, 3]] + (0, 0, 1, 1))[kept])


def test_planes_that_are_no_range_are_refused() -> None:
    view = VIEWS[0]
    settings = {"z_near": 2.0, "z_far": 1.0}
    with msb.Renderer(asset_of(view), "dedicated", name="wgpu", settings=settings) as renderer:
        with pytest.raises(MsbError) as info:
            renderer.render(view.camera)
        assert info.value.code == "SETTING_VALUE"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_whatever_is_drawn_is_as_in_opencl(seed: int) -> None:
    """Slivers, faces without area or that coincide, and all around the camera.

    Where the planes are far apart, the float32 inverse by which directions are computed officially is off by
    more than the decoder's rounding; here they come from the camera's rotation.
    """
    case = draw_case("diffsoup", seed)
    options = {name: case.options[name] for name in ("order", "sampling")}
    found = drawn(HardwareRenderer, case.asset, case, **options)
    equal(found, drawn(Pipeline, case.asset, case, outputs=(), **options), within=2e-3)
