"""The dedicated tier through a graphics pipeline, on whatever adapter there is: lavapipe where no card is."""

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
from msb.methods.diffsoup.look import Pipeline as DiffSoupPipeline
from msb.methods.diffsoup.reference import pixel_boxes
from msb.registry import role
from msb.render import Frame
from msb.render.splat.pipeline import SplattingPipeline
from tests.engines.conftest import need
from tests.reference.golden import View, exported, golden_views, names, psnr
from tests.render.random_cases import draw_case

METHODS = ("two_dts", "triangle_splatting", "mesh_splatting")
VIEWS = [view for method in METHODS for view in golden_views(method)]
FEW = (8, 19, 22)
FLOAT = {"two_dts": 80, "triangle_splatting": 70, "mesh_splatting": 75}
HALF = {"two_dts": 55, "triangle_splatting": 60, "mesh_splatting": 60}
"""dB to the official image. Samples stop where a chunk of faces began with little enough left."""

pytestmark = pytest.mark.oracle
every = pytest.mark.parametrize(
    "view",
    [pytest.param(view, marks=() if k in FEW else pytest.mark.slow) for k, view in enumerate(VIEWS)],
    ids=names,
)
some = pytest.mark.parametrize("view", VIEWS[::3], ids=names)
MODES = (("tile", "engine"), ("none", "engine"), ("global", "official"), ("none", "official"))
EACH_MODE = [
    (view, *mode)
    for method in METHODS
    for k, mode in enumerate(MODES)
    for view in golden_views(method)[2 * k : 2 * k + 1]
]
"""Every method in every mode, each time on another view."""


@pytest.fixture(autouse=True)
def _needs_wgpu() -> None:
    need("wgpu")


def asset_of(view: View) -> Asset:
    return exported(view.folder / "checkpoint")


def method_of(view: View) -> str:
    return view.folder.parent.name


def drawn_by(make: Any, asset: Asset, view: Any, **options: Any) -> Frame:
    with closing(make(asset, settings=view.settings, **options)) as renderer:
        return renderer.render(view.camera, view.background)


def drawn(view: View, **options: Any) -> Frame:
    return drawn_by(HardwareRenderer, asset_of(view), view, **options)


def drawn_by_opencl(view: View, **options: Any) -> Frame:
    return drawn_by(SplattingPipeline, asset_of(view), view, outputs=(), **options)


def decibels(found: NDArray[Any], wanted: NDArray[Any], stable: Any = None) -> float:
    """Return the PSNR; the peak is that of the official image, which may exceed 1."""
    error = np.square(found.astype(np.float64) - wanted)
    peak = max(1.0, float(wanted.max()))
    return float(10 * np.log10(peak**2 / max(error[slice(None) if stable is None else stable].mean(), 1e-20)))


class Listening:
    """The official modes, for which it notes what a reference renderer decided instead of drawing it."""

    order = "tile"

    def __init__(self, sampling: str) -> None:
        self.sampling, self.engine = sampling, sampling == "engine"

    def tiles(self, rectangles: Any, depth: Any, kept: Any, view: Any) -> Iterator[Any]:
        self.seen = np.concatenate([rectangles.low, rectangles.high], axis=1), depth, kept
        return iter(())


def same_decisions(view: View, sampling: str) -> None:
    """Hold kept faces, depth keys and official tile rectangles to the reference, bit for bit."""
    asset, camera, settings = asset_of(view), view.camera, view.settings
    listening = Listening(sampling)
    reference: Any = role(asset.manifest.method, "reference")
    values = effective_settings(asset.manifest, settings)
    black = np.zeros(3, np.float32)
    with np.errstate(all="ignore"):
        reference.render(asset, camera, black, values, np.float32, listening)
    wanted, depth, kept = listening.seen
    with HardwareRenderer(asset, settings=settings, sampling=sampling, debug=True) as renderer:
        renderer.draw(camera, (0, 0, 0))
        keys, rectangles = renderer.decisions()
    np.testing.assert_array_equal(keys != 0xFFFFFFFF, kept)
    np.testing.assert_array_equal(rectangles[kept], wanted[kept])
    listed = keys < 0xFFFFFFFE
    assert listed.any()
    np.testing.assert_array_equal(keys[listed], depth.astype(np.float32).view(np.uint32)[listed])


@every
def test_every_golden_view_is_the_official_image(view: View) -> None:
    frame = drawn(view)
    assert decibels(frame.image, view.image, view.stable) >= FLOAT[method_of(view)]
    if "radii" in view.stored:
        np.testing.assert_array_equal(frame.visible, view.stored["radii"] > 0)
    own = drawn_by_opencl(view)
    assert decibels(frame.alpha, own.alpha) >= 50
    seen = own.alpha > 0.01
    assert np.median(np.abs(frame.depth - own.depth)[seen] / own.depth[seen]) <= 1e-2


@every
def test_what_decides_is_the_reference_s_bit_for_bit(view: View) -> None:
    same_decisions(view, "official")


@pytest.mark.slow
@some
def test_what_decides_in_an_engine_is_the_reference_s_bit_for_bit(view: View) -> None:
    same_decisions(view, "engine")


@pytest.mark.slow
@some
def test_half_floats_are_nearly_as_good(view: View) -> None:
    assert decibels(drawn(view, half=True).image, view.image, view.stable) >= HALF[method_of(view)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "order", "sampling"),
    EACH_MODE,
    ids=["-".join((names(view), *mode)) for view, *mode in EACH_MODE],
)
def test_orders_and_samplings_are_those_of_opencl(view: View, order: Any, sampling: Any) -> None:
    found, wanted = (draw(view, order=order, sampling=sampling) for draw in (drawn, drawn_by_opencl))
    np.testing.assert_array_equal(found.visible, wanted.visible)
    assert decibels(found.image, wanted.image) >= 60


@pytest.mark.slow
@pytest.mark.parametrize("limits", [Limits(100_000, 1 << 24, 100), Limits(1 << 27, 1 << 24, 16384)])
@pytest.mark.parametrize("stops", [1, STOPS])
def test_the_same_frame_has_the_same_bytes_however_it_is_cut(
    limits: Limits, stops: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five parts of coefficients, two of records and twelve bands, and a second frame of one renderer."""
    view = golden_views("triangle_splatting")[0]
    wanted = drawn(view, stops=stops)
    monkeypatch.setattr(hardware, "_limits_of", lambda _: limits)
    with HardwareRenderer(asset_of(view), settings=view.settings, stops=stops) as renderer:
        assert ("records 1" in renderer.memory()) == (limits.binding == 100_000 or stops > 1)
        for _ in range(2):
            found = renderer.render(view.camera, view.background)
            for name in ("image", "alpha", "depth"):
                assert getattr(found, name).tobytes() == getattr(wanted, name).tobytes()


@pytest.mark.parametrize("limits", [Limits(50_000, 1 << 24, 8192), Limits(1 << 27, 300_000, 8192)])
def test_what_does_not_fit_is_told(limits: Limits, monkeypatch: pytest.MonkeyPatch) -> None:
    view = golden_views("triangle_splatting")[0]
    monkeypatch.setattr(hardware, "_limits_of", lambda _: limits)
    with pytest.raises(MsbError) as info:
        drawn(view)
    assert info.value.code == "DEVICE_MEMORY"
    assert "\n" not in info.value.message


@pytest.mark.slow
def test_a_lost_device_and_a_closed_renderer_are_told() -> None:
    view = golden_views("triangle_splatting")[0]
    renderer = HardwareRenderer(asset_of(view), settings=view.settings)
    renderer._gpu.device.destroy()
    for code in ("ENGINE_FAILED", "DEVICE_CLOSED"):
        with pytest.raises(MsbError) as info:
            renderer.draw(view.camera, (0, 0, 0))
        assert info.value.code == code
        assert "\n" not in info.value.message
        renderer.close()


def test_a_renderer_like_ours() -> None:
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
        assert {groups["positions"], groups["f_rest"], groups["image"]} == {
            "geometry",
            "appearance",
            "targets",
        }


def test_a_method_without_wgsl_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    made = packing.make_model
    monkeypatch.setattr(packing, "make_model", lambda *args: replace(made(*args), program="facets"))
    with pytest.raises(MsbError) as info:
        drawn(golden_views("triangle_splatting")[0])
    assert (info.value.code, info.value.exit_status) == ("UNSUPPORTED_TIER", 4)
    assert "brings no WGSL" in info.value.message


def test_options_that_only_this_tier_has_are_refused_elsewhere() -> None:
    asset = asset_of(golden_views("triangle_splatting")[0])
    with pytest.raises(MsbError) as info:
        msb.Renderer(asset, "standard", name="wgpu", sampling="engine")
    assert info.value.code == "UNSUPPORTED_OPTION"


@pytest.fixture(scope="module")
def garden(tmp_path_factory: pytest.TempPathFactory, shared: Path) -> Path:
    """Return models of a triangle for each point of a real capture."""
    from benchmarks.garden import surface_of
    from data_stubs.made_models import write_models

    folder = tmp_path_factory.mktemp("garden")
    write_models(folder, surface_of(shared / "golden" / "garden"), white=False, layout="colmap")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "bar"), [("two_dts", 90), ("triangle_splatting", 75), ("mesh_splatting", 70)]
)
def test_a_capture_of_139_000_faces(method: str, bar: float, garden: Path, shared: Path) -> None:
    """Against OpenCL, which is the official image to 140 dB."""
    asset = msb.export(garden / method)
    cameras = msb.read_cameras(shared / "golden" / "garden" / "sparse" / "0")
    with (
        msb.Renderer(asset, "dedicated", outputs=()) as ours,
        msb.Renderer(asset, "dedicated", name="wgpu") as theirs,
    ):
        for camera in (cameras[0].resized(648, 420), cameras[16].resized(648, 420)):
            wanted, found = ours.render(camera), theirs.render(camera)
            np.testing.assert_array_equal(found.visible, wanted.visible)
            assert decibels(found.image, wanted.image) >= bar


SURFACES = golden_views("diffsoup")


def same_as_opencl(asset: Asset, view: View, **options: Any) -> Frame:
    """Hold a frame to that of our OpenCL: all but colours to the bit."""
    found = drawn_by(HardwareRenderer, asset, view, **options)
    same(found, drawn_by(DiffSoupPipeline, asset, view, outputs=(), **options))
    return found


def same(found: Frame, wanted: Frame, within: float = 1e-5) -> None:
    for name in ("alpha", "depth", "visible"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    np.testing.assert_allclose(found.image, wanted.image, rtol=0, atol=within)


@pytest.mark.parametrize(
    "view",
    [pytest.param(view, marks=() if view is SURFACES[3] else pytest.mark.slow) for view in SURFACES],
    ids=names,
)
def test_every_golden_view_of_diffsoup_is_the_official_image(view: View) -> None:
    frame = same_as_opencl(asset_of(view), view)
    assert psnr(frame.image[view.stable], view.image[view.stable]) > 128


@pytest.mark.slow
@pytest.mark.parametrize("view", SURFACES, ids=names)
def test_triangles_across_the_camera_plane_are_clipped_as_in_opencl(view: View) -> None:
    same_as_opencl(asset_of(view), view, sampling="engine", order="none")


@pytest.mark.slow
@pytest.mark.parametrize("view", SURFACES[::3], ids=names)
def test_bytes_of_the_web_export_are_drawn_as_in_opencl(view: View) -> None:
    same_as_opencl(view.web, view)


@pytest.mark.slow
@pytest.mark.parametrize("view", SURFACES, ids=names)
def test_rectangles_of_diffsoup_are_the_reference_s_bit_for_bit(view: View) -> None:
    asset = asset_of(view)
    clip = drawn_by(DiffSoupPipeline, asset, view, outputs="all").raw["clip_corners"]
    dropped, boxes = pixel_boxes(clip, view.camera.width, view.camera.height)
    with HardwareRenderer(asset, settings=view.settings, debug=True) as renderer:
        renderer.draw(view.camera, (0, 0, 0))
        _, rectangles = renderer.decisions()
    kept = rectangles[:, 2] > 0
    np.testing.assert_array_equal(kept, ~dropped)
    np.testing.assert_array_equal(rectangles[kept], (boxes[:, [0, 2, 1, 3]] + (0, 0, 1, 1))[kept])


def test_planes_that_are_no_range_are_refused() -> None:
    view = SURFACES[0]
    settings = {"z_near": 2.0, "z_far": 1.0}
    with msb.Renderer(asset_of(view), "dedicated", name="wgpu", settings=settings) as renderer:
        with pytest.raises(MsbError) as info:
            renderer.render(view.camera)
        assert info.value.code == "SETTING_VALUE"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_whatever_diffsoup_draws_is_as_in_opencl(seed: int) -> None:
    """Slivers, faces without area or that coincide, and all around the camera.

    Where the planes are far apart, the float32 inverse by which directions are computed officially is off by
    more than the decoder's rounding; here they come from the camera's rotation.
    """
    case = draw_case("diffsoup", seed)
    options = {name: case.options[name] for name in ("order", "sampling")}
    found = drawn_by(HardwareRenderer, case.asset, case, **options)
    same(found, drawn_by(DiffSoupPipeline, case.asset, case, outputs=(), **options), within=2e-3)
