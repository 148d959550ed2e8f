"""The dedicated tier with a graphics pipeline. Without a graphics card, lavapipe draws in software."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.asset import Asset
from msb.asset.settings import effective_settings
from msb.engines.hardware import packing
from msb.engines.hardware import renderer as hardware
from msb.engines.hardware.plan import Limits
from msb.engines.hardware.program import STOPS
from msb.engines.hardware.renderer import HardwareRenderer
from msb.errors import MsbError
from msb.methods.diffsoup.native import Pipeline as DiffSoupPipeline
from msb.methods.diffsoup.reference import pixel_boxes
from msb.registry import role
from msb.render import Frame
from msb.render.splat.pipeline import SplattingPipeline
from tests.engines.conftest import need
from tests.reference.golden import View, exported, golden_views, names, psnr
from tests.render.random_cases import draw_case

METHODS = ("two_dts", "triangle_splatting", "mesh_splatting")
VIEWS = [view for method in METHODS for view in golden_views(method)]
QUICK = (8, 19, 22)  # numbers of the views that are not marked slow: one of each method
# Minimum PSNR in dB against the official image, with float32 and with half-float targets. The images differ a
# little, because this renderer stops a sample only at the end of a chunk of faces.
FLOAT_DB = {"two_dts": 80, "triangle_splatting": 70, "mesh_splatting": 75}
HALF_DB = {"two_dts": 55, "triangle_splatting": 60, "mesh_splatting": 60}

pytestmark = pytest.mark.oracle
every_view = pytest.mark.parametrize(
    "view",
    [pytest.param(view, marks=() if k in QUICK else pytest.mark.slow) for k, view in enumerate(VIEWS)],
    ids=names,
)
every_third_view = pytest.mark.parametrize("view", VIEWS[::3], ids=names)
MODES = (("tile", "engine"), ("none", "engine"), ("global", "official"), ("none", "official"))
# Every method in every mode, each time with a different view.
VIEW_OF_MODE = [
    (view, *mode)
    for method in METHODS
    for k, mode in enumerate(MODES)
    for view in golden_views(method)[2 * k : 2 * k + 1]
]


@pytest.fixture(autouse=True)
def _needs_wgpu() -> None:
    need("wgpu")


def asset_of(view: View) -> Asset:
    return exported(view.folder / "checkpoint")


def method_of(view: View) -> str:
    return view.folder.parent.name


def draw_by(renderer_class: Any, asset: Asset, view: Any, **options: Any) -> Frame:
    with closing(renderer_class(asset, settings=view.settings, **options)) as renderer:
        return renderer.render(view.camera, view.background)


def draw(view: View, **options: Any) -> Frame:
    return draw_by(HardwareRenderer, asset_of(view), view, **options)


def draw_by_opencl(view: View, **options: Any) -> Frame:
    return draw_by(SplattingPipeline, asset_of(view), view, outputs=(), **options)


def decibels(image: NDArray[Any], official: NDArray[Any], stable: Any = None) -> float:
    """Return the PSNR in dB over the `stable` pixels; the peak is the official maximum, at least 1."""
    error = np.square(image.astype(np.float64) - official)
    peak = max(1.0, float(official.max()))
    return float(10 * np.log10(peak**2 / max(error[slice(None) if stable is None else stable].mean(), 1e-20)))


class TileRecorder:
    """Replaces the order of a reference renderer: stores the decisions for each face, and draws nothing."""

    order = "tile"

    def __init__(self, sampling: str) -> None:
        self.sampling, self.engine = sampling, sampling == "engine"

    def tiles(self, rectangles: Any, depth: Any, kept: Any, view: Any) -> Iterator[Any]:
        self.decisions = np.concatenate([rectangles.low, rectangles.high], axis=1), depth, kept
        return iter(())


def assert_same_decisions(view: View, sampling: str) -> None:
    """Check that kept faces, depth keys and tile rectangles equal those of the reference, bit for bit."""
    asset, camera, settings = asset_of(view), view.camera, view.settings
    recorder = TileRecorder(sampling)
    reference: Any = role(asset.manifest.method, "reference")
    values = effective_settings(asset.manifest, settings)
    with np.errstate(all="ignore"):
        reference.render(asset, camera, np.zeros(3, np.float32), values, np.float32, recorder)
    expected, depth, kept = recorder.decisions
    with HardwareRenderer(asset, settings=settings, sampling=sampling, debug=True) as renderer:
        renderer.draw(camera, (0, 0, 0))
        keys, rectangles = renderer.decisions()
    np.testing.assert_array_equal(keys != 0xFFFFFFFF, kept)
    np.testing.assert_array_equal(rectangles[kept], expected[kept])
    listed = keys < 0xFFFFFFFE
    assert listed.any()
    np.testing.assert_array_equal(keys[listed], depth.astype(np.float32).view(np.uint32)[listed])


@every_view
def test_every_golden_view_is_the_official_image(view: View) -> None:
    frame = draw(view)
    assert decibels(frame.image, view.image, view.stable) >= FLOAT_DB[method_of(view)]
    if "radii" in view.stored:
        np.testing.assert_array_equal(frame.visible, view.stored["radii"] > 0)
    opencl = draw_by_opencl(view)
    assert decibels(frame.alpha, opencl.alpha) >= 50
    covered = opencl.alpha > 0.01
    assert np.median(np.abs(frame.depth - opencl.depth)[covered] / opencl.depth[covered]) <= 1e-2


@every_view
def test_decisions_per_face_are_those_of_the_reference(view: View) -> None:
    assert_same_decisions(view, "official")


@pytest.mark.slow
@every_third_view
def test_engine_sampling_and_half_floats(view: View) -> None:
    assert_same_decisions(view, "engine")
    assert decibels(draw(view, half=True).image, view.image, view.stable) >= HALF_DB[method_of(view)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "order", "sampling"),
    VIEW_OF_MODE,
    ids=["-".join((names(view), *mode)) for view, *mode in VIEW_OF_MODE],
)
def test_orders_and_samplings_are_those_of_opencl(view: View, order: Any, sampling: Any) -> None:
    frame, opencl = (make(view, order=order, sampling=sampling) for make in (draw, draw_by_opencl))
    np.testing.assert_array_equal(frame.visible, opencl.visible)
    assert decibels(frame.image, opencl.image) >= 60


@pytest.mark.slow
@pytest.mark.parametrize("limits", [Limits(100_000, 1 << 24, 100), Limits(1 << 27, 1 << 24, 16384)])
@pytest.mark.parametrize("stops", [1, STOPS])
def test_small_device_limits_do_not_change_the_frame(
    limits: Limits, stops: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The smaller limits give five parts of coefficients, two of records and twelve bands."""
    view = golden_views("triangle_splatting")[0]
    expected = draw(view, stops=stops)
    monkeypatch.setattr(hardware, "_limits_of", lambda _: limits)
    with HardwareRenderer(asset_of(view), settings=view.settings, stops=stops) as renderer:
        assert ("records 1" in renderer.memory()) == (limits.binding == 100_000 or stops > 1)
        for _ in range(2):
            frame = renderer.render(view.camera, view.background)
            for name in ("image", "alpha", "depth"):
                assert getattr(frame, name).tobytes() == getattr(expected, name).tobytes()


@pytest.mark.parametrize("limits", [Limits(50_000, 1 << 24, 8192), Limits(1 << 27, 300_000, 8192)])
def test_a_model_that_does_not_fit_is_an_error(limits: Limits, monkeypatch: pytest.MonkeyPatch) -> None:
    view = golden_views("triangle_splatting")[0]
    monkeypatch.setattr(hardware, "_limits_of", lambda _: limits)
    with pytest.raises(MsbError) as info:
        draw(view)
    assert info.value.code == "DEVICE_MEMORY"


@pytest.mark.slow
def test_a_lost_device_and_a_closed_renderer_are_errors() -> None:
    view = golden_views("triangle_splatting")[0]
    renderer = HardwareRenderer(asset_of(view), settings=view.settings)
    renderer._gpu.device.destroy()
    for code in ("ENGINE_FAILED", "DEVICE_CLOSED"):
        with pytest.raises(MsbError) as info:
            renderer.draw(view.camera, (0, 0, 0))
        assert info.value.code == code
        assert "\n" not in info.value.message
        renderer.close()


def test_the_renderer_has_the_common_interface() -> None:
    view = golden_views("mesh_splatting")[2]
    with msb.Renderer(asset_of(view), "dedicated", name="wgpu", settings=view.settings) as renderer:
        assert renderer.name.startswith("wgpu ")
        assert set(renderer.device_info) == {"platform", "name", "kind", "blends"}
        assert "float" in renderer.device_info["blends"]
        frame = renderer.render(view.camera, view.background)
        assert frame.image.dtype == frame.alpha.dtype == frame.depth.dtype == np.float32
        time = renderer.draw(view.camera)
        assert set(time.stages) == set(frame.timings) == {"project", "sort", "records", "blend", "resolve"}
        assert time.span > 0
        uses, groups = renderer.memory(), renderer.memory_groups()
        assert set(groups) <= set(uses)
        names = ("positions", "f_rest", "image")
        assert [groups[name] for name in names] == ["geometry", "appearance", "targets"]


def test_unsupported_options_and_methods_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    view = golden_views("triangle_splatting")[0]
    with pytest.raises(MsbError) as info:  # an option of the dedicated tier
        msb.Renderer(asset_of(view), "standard", name="wgpu", sampling="engine")
    assert info.value.code == "UNSUPPORTED_OPTION"
    make_model = packing.make_model
    monkeypatch.setattr(packing, "make_model", lambda *args: replace(make_model(*args), program="facets"))
    with pytest.raises(MsbError) as info:  # a method without WGSL
        draw(view)
    assert (info.value.code, info.value.exit_status) == ("UNSUPPORTED_TIER", 4)


@pytest.fixture(scope="module")
def garden(tmp_path_factory: pytest.TempPathFactory, shared: Path) -> Path:
    """Return a folder of models with one triangle for each point of a real capture."""
    from benchmarks.garden import surface_of
    from data_stubs.made_models import write_models

    folder = tmp_path_factory.mktemp("garden")
    write_models(folder, surface_of(shared / "golden" / "garden"), white=False, layout="colmap")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "minimum"), [("two_dts", 90), ("triangle_splatting", 75), ("mesh_splatting", 70)]
)
def test_a_capture_of_139_000_faces(method: str, minimum: float, garden: Path, shared: Path) -> None:
    """Compare with the OpenCL renderer, whose images have at least 140 dB against the official images."""
    asset = msb.export(garden / method)
    cameras = msb.read_cameras(shared / "golden" / "garden" / "sparse" / "0")
    with (
        msb.Renderer(asset, "dedicated", outputs=()) as ours,
        msb.Renderer(asset, "dedicated", name="wgpu") as theirs,
    ):
        for camera in (cameras[0].resized(648, 420), cameras[16].resized(648, 420)):
            expected, frame = ours.render(camera), theirs.render(camera)
            np.testing.assert_array_equal(frame.visible, expected.visible)
            assert decibels(frame.image, expected.image) >= minimum


SURFACES = golden_views("diffsoup")


def draw_as_opencl(asset: Asset, view: Any, *, tolerance: float = 1e-5, **options: Any) -> Frame:
    """Return a frame. Check that it equals the OpenCL renderer's frame, up to `tolerance` in colours."""
    frame = draw_by(HardwareRenderer, asset, view, **options)
    opencl = draw_by(DiffSoupPipeline, asset, view, outputs=(), **options)
    for name in ("alpha", "depth", "visible"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(opencl, name), err_msg=name)
    np.testing.assert_allclose(frame.image, opencl.image, rtol=0, atol=tolerance)
    return frame


@pytest.mark.parametrize(
    "view",
    [pytest.param(view, marks=() if view is SURFACES[3] else pytest.mark.slow) for view in SURFACES],
    ids=names,
)
def test_every_golden_view_of_diffsoup_is_the_official_image(view: View) -> None:
    frame = draw_as_opencl(asset_of(view), view)
    assert psnr(frame.image[view.stable], view.image[view.stable]) > 128


@pytest.mark.slow
@pytest.mark.parametrize("view", SURFACES, ids=names)
def test_triangles_across_the_camera_plane_are_clipped_as_in_opencl(view: View) -> None:
    draw_as_opencl(asset_of(view), view, sampling="engine", order="none")


@pytest.mark.slow
@pytest.mark.parametrize("view", SURFACES[::3], ids=names)
def test_the_bytes_of_the_web_export_are_drawn_as_in_opencl(view: View) -> None:
    draw_as_opencl(view.web, view)


@pytest.mark.slow
@pytest.mark.parametrize("view", SURFACES, ids=names)
def test_rectangles_of_diffsoup_are_those_of_the_reference(view: View) -> None:
    asset = asset_of(view)
    clip = draw_by(DiffSoupPipeline, asset, view, outputs="all").raw["clip_corners"]
    dropped, boxes = pixel_boxes(clip, view.camera.width, view.camera.height)
    with HardwareRenderer(asset, settings=view.settings, debug=True) as renderer:
        renderer.draw(view.camera, (0, 0, 0))
        _, rectangles = renderer.decisions()
    kept = rectangles[:, 2] > 0
    np.testing.assert_array_equal(kept, ~dropped)
    np.testing.assert_array_equal(rectangles[kept], (boxes[:, [0, 2, 1, 3]] + (0, 0, 1, 1))[kept])


def test_a_far_plane_before_the_near_plane_is_rejected() -> None:
    view = SURFACES[0]
    settings = {"z_near": 2.0, "z_far": 1.0}
    with msb.Renderer(asset_of(view), "dedicated", name="wgpu", settings=settings) as renderer:
        with pytest.raises(MsbError) as info:
            renderer.render(view.camera)
        assert info.value.code == "SETTING_VALUE"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_models_of_diffsoup_are_drawn_as_in_opencl(seed: int) -> None:
    """The models have slivers, degenerate and coincident faces, and faces all around the camera.

    The official renderer computes view directions with a float32 inverse. If the near and far planes are far
    apart, the error of this inverse exceeds the rounding of the decoder. This renderer takes directions from
    the rotation of the camera, so the tolerance of colours is larger here.
    """
    case = draw_case("diffsoup", seed)
    options = {name: case.options[name] for name in ("order", "sampling")}
    draw_as_opencl(case.asset, case, tolerance=2e-3, **options)
