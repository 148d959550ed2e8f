"""Orders and samplings of an engine: kernels of both styles against the NumPy reference."""

from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.cl import Device
from msb.errors import Unsupported, UsageError
from msb.methods.diffsoup.native import Pipeline as DiffSoupPipeline
from msb.reference import render_reference
from msb.render.dedicated import dedicated_renderer
from msb.render.frame import Frame
from msb.scenes import Camera
from tests.reference.golden import names
from tests.reference.soups import SPLATTING, constant_color, front_camera, random_triangles, soup
from tests.render.frames import assert_near, frame_of
from tests.render.test_diffsoup import TAME, VIEWS
from tests.render.test_splatting import model

pytestmark = pytest.mark.slow

VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("two_dts", {}),
    ("two_dts", {"sh_degree": 1, "gamma": 7.5, "back_culling": True, "gamma_rescale": True}),
    ("two_dts", {"rasterizer": "3D", "gamma": 50.0, "ste_threshold": 0.4, "render_up_scale": 2}),
    ("triangle_splatting", {"view_dir": "centroid", "sh_degree": 2}),
    ("mesh_splatting", {"opacity_floor": 0.1, "sigma": 0.3, "supersample": 1}),
    ("mesh_splatting", {}),
]
PLAIN = [VARIANTS[0], VARIANTS[3], VARIANTS[4]]
CASES = [
    *((*variant, "tile", "engine") for variant in VARIANTS),
    *((*variant, "none", "engine") for variant in PLAIN),
    *((*variant, order, "official") for variant in PLAIN for order in ("global", "none")),
]
GREEN = (0.2, 0.7, 0.4)


def draw(asset: Asset, device: Device, camera: Camera, background: Any = GREEN, **options: Any) -> Frame:
    return frame_of(dedicated_renderer, asset, device, camera, background, **{"outputs": "all", **options})


def crossing(method: str, seed: int) -> Asset:
    """Return a model with triangles that cross the near plane, and the camera among the triangles."""
    asset = model(method, seed)
    positions = asset.buffers["positions"].copy()
    positions.reshape(-1, 3, 3)[130:200] -= (0, 0, 4)
    object.__setattr__(asset, "buffers", {**asset.buffers, "positions": positions})
    return asset


@pytest.mark.slow
@pytest.mark.parametrize(("method", "settings", "order", "sampling"), CASES)
def test_equals_the_reference(
    method: str, settings: dict[str, Any], order: Any, sampling: Any, cpu: Device, gpu: Device
) -> None:
    asset, camera = crossing(method, 1), front_camera(64, 44, cx=20.5, cy=31.25)
    wanted = render_reference(asset, camera, GREEN, settings, order=order, sampling=sampling)
    assert wanted.alpha.mean() > 0.1
    for device in (cpu, gpu):
        frame = draw(asset, device, camera, settings=settings, order=order, sampling=sampling)
        assert_near(frame, wanted)
        for name in frame.raw.keys() & wanted.raw.keys():
            assert (
                np.abs(frame.raw[name] - wanted.raw[name]) > 1e-4 * max(1, np.abs(wanted.raw[name]).max())
            ).mean() <= 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
def test_one_triangle_through_the_camera_plane_covers_everything(method: str, device: Device) -> None:
    rows = 3 if method == "mesh_splatting" else 1
    sharp = {"sigma": np.full(1, -9, np.float32)} if method == "triangle_splatting" else {}
    opaque = {"opacity": np.full(rows, 12, np.float32), "f_dc": constant_color(rows, (0.9, 0.5, 0.1))}
    floor = np.array([[[-60, 0.4, -50], [60, 0.4, -50], [0, 0.4, 900]]], np.float32)
    below = front_camera(90, 70, cy=-5.0)
    frame = draw(soup(method, floor, **opaque, **sharp), device, below, sampling="engine")
    wanted = render_reference(soup(method, floor, **opaque, **sharp), below, GREEN, sampling="engine")
    assert frame.alpha.min() > 0.3
    np.testing.assert_allclose(frame.image, wanted.image, atol=2e-5)
    np.testing.assert_allclose(frame.depth, wanted.depth, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("view", [VIEWS[5], VIEWS[6], TAME[0]], ids=names)
def test_diffsoup_clips_as_its_official_viewer(view: Any, device: Device) -> None:
    """Compare with golden images of a rasterizer.

    The official evaluator drops triangles across the camera plane.
    """
    asset, camera, settings = view.web, view.camera, view.settings
    wanted = render_reference(asset, camera, view.background, settings, sampling="engine")
    equal = {}
    for sampling in ("official", "engine"):
        options = {"settings": settings, "viewer": True, "sampling": sampling}
        frame = frame_of(DiffSoupPipeline, asset, device, camera, view.background, **options)
        levels = np.rint(255 * view.kernel_rows(frame.image)) - view.viewer["viewer_image"].astype(int)
        equal[sampling] = (np.abs(levels).max(axis=-1) == 0).mean()
    np.testing.assert_array_equal(frame.face_id, wanted.face_id)
    np.testing.assert_array_equal(frame.visible, wanted.visible)
    assert equal["engine"] > 0.998
    assert (equal["official"] < 0.8) == (view in VIEWS[5:7])


def test_modes_are_rejected_by_tiers_without_them() -> None:
    asset = soup("two_dts", random_triangles(1))
    with pytest.raises(Unsupported, match="order") as caught:
        msb.Renderer(asset, tier="standard", order="none")
    assert (caught.value.code, caught.value.exit_status) == ("UNSUPPORTED_OPTION", 4)
    with pytest.raises(Unsupported, match="UNSUPPORTED_OPTION"):
        msb.Renderer(asset, tier="dedicated", viewer=True)
    for tier in ("dedicated", "reference"):
        with pytest.raises(UsageError, match="sampling"):
            msb.Renderer(asset, tier=tier, sampling="center")
        with pytest.raises(UsageError, match="order"):
            msb.Renderer(soup("diffsoup", random_triangles(1)), tier=tier, order="depth")
