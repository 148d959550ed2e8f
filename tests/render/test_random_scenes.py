"""Every method, setting, order and sampling on random scenes, and cases that once failed.

MSB_RANDOM_SCENES=1000 in the environment draws that many scenes of each method instead of five.
"""

import os
from typing import Any

import numpy as np
import pytest

from msb.cl import Device
from msb.reference import render_reference
from msb.registry import METHODS as METHOD_TABLE
from msb.registry import ORDERS, SAMPLINGS
from msb.render.dedicated import dedicated_renderer
from msb.scenes import Camera
from tests.reference.soups import METHODS, SPLATTING, front_camera, random_triangles, soup
from tests.render import standard_scenes
from tests.render.differential import OFF, apart, difference, draw, reference_frame
from tests.render.random_cases import KINDS, STANDARD, draw_case, draw_settings

pytestmark = pytest.mark.slow

# Scenes of each method.
DRAWS = int(os.environ.get("MSB_RANDOM_SCENES", 5))


@pytest.mark.parametrize("method", [*METHODS, STANDARD])
def test_equals_the_reference(method: str, cpu: Device, gpu: Device) -> None:
    """Differences are explained by rounding: at most 0.1 % of the pixels differ, and PSNR is above 60 dB.

    Most scenes also match the reference in double precision. In some scenes, rounding changes the order of
    all faces.
    """
    pixels = explained = 0
    shares = []
    for seed in range(100, 100 + DRAWS):
        case = draw_case(method, seed)
        device = cpu if case.style == "cpu" else gpu
        result = difference(case, device)
        assert not result.off, f"{case}: {result.off}"
        assert result.quality > (80 if method == STANDARD else 90), str(case)
        pixels, explained = pixels + result.pixels, explained + result.explained.get("image", 0)
        if method != STANDARD:
            frame = draw(dedicated_renderer, case, device)
            shares.append(apart(frame.image, reference_frame(case, np.float64).image, OFF).mean())
    assert pixels > 700
    assert explained <= 0.01 * pixels
    assert not shares or np.median(shares) < 1e-3


def test_draws_have_everything() -> None:
    """The seeds cover all settings and their choices, all modes and all kinds of scene of each method."""
    for method in METHODS:
        cases = [draw_case(method, seed) for seed in range(100)]
        assert {case.kind for case in cases} == set(KINDS)
        assert {case.style for case in cases} == {"cpu", "gpu"}
        for name, choices in (("order", ORDERS), ("sampling", SAMPLINGS)):
            assert {case.options[name] for case in cases} == set(choices)
        assert any(case.camera.width * case.camera.height <= 2 for case in cases)
        settings = [draw_settings(np.random.default_rng(seed), method) for seed in range(60)]
        for name, setting in METHOD_TABLE[method].settings.items():
            values = {choice[name] for choice in settings}
            assert all(setting.problem(value) is None for value in values)
            assert len(values) > 1
            assert values >= set(setting.choices) | ({None} if setting.optional else set())


@pytest.mark.parametrize("scale", [2, 3, 5, 7])
@pytest.mark.parametrize("method", ["two_dts", "mesh_splatting"])
def test_raw_buffers_at_any_scale(method: str, scale: int, cpu: Device, gpu: Device) -> None:
    """Regression: offsets were wrong in rasters whose rows are not a multiple of tiles and pixels."""
    settings: dict[str, Any] = {"render_up_scale": scale}
    if method == "mesh_splatting":
        settings = {"supersample": scale, "opacity_floor": 0.0, "sigma": 0.5}
    asset, camera = soup(method, random_triangles(4)), front_camera(17, 17)
    wanted = render_reference(asset, camera, settings=settings).raw
    for device in (cpu, gpu):
        renderer = dedicated_renderer(asset, device=device, settings=settings, outputs=("raw",))
        raw = renderer.render(camera, (0, 0, 0)).raw
        renderer.close()
        assert len(raw) >= 3
        for name, array in raw.items():
            assert array.shape[:2] == (17 * scale, 17 * scale)
            assert apart(array, wanted[name], 1e-4).mean() < 2e-3, name


def test_depth_of_a_needle_that_leads_away(cpu: Device, gpu: Device) -> None:
    """Regression: the depth of a plane was wrong by 0.05 %, because it was computed from the far corner."""
    corners = np.array([[-6, -2.879, 35], [-0.054, -0.1, 0.35], [-0.03, 0.12, 0.4]], np.float32)
    view = standard_scenes.camera(140, 132, 190.0)
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    rays = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=-1)
    exact = corners.astype(np.float64)
    normal = np.cross(exact[1] - exact[0], exact[2] - exact[0])
    depth = (normal @ exact[0]) / (rays @ normal)
    mesh = standard_scenes.unshared(corners[None])
    for device in (cpu, gpu):
        frame = standard_scenes.draw(device, standard_scenes.mesh_asset(mesh), view)
        hit = frame.alpha > 0
        assert hit.sum() > 300
        assert np.median(np.abs(frame.depth / depth - 1)[hit]) < 5e-5


@pytest.mark.parametrize("method", SPLATTING)
def test_an_engine_keeps_the_same_faces_at_the_edge_of_a_sample(
    method: str, cpu: Device, gpu: Device
) -> None:
    """The faces are small, and the bounding box of each face begins just after a sample."""
    camera = Camera(32, 32, 32.0, 32.0, 15.5, 15.5, np.eye(4))
    corners = np.array([[0, 0], [0.02, 0], [0, 0.02]])
    flat = 0.1 + 10.0 ** np.arange(-5.0, -2.0, 0.25)[:, None, None] - 5 + corners
    triangles = np.concatenate([flat, np.full((12, 3, 1), 32.0)], axis=2)
    window = {"sigma": np.full(12, -9, np.float32)} if method == "triangle_splatting" else {}
    asset = soup(method, (triangles / 16).astype(np.float32), **window)
    wanted = render_reference(asset, camera, sampling="engine").visible
    for device in (cpu, gpu):
        renderer = dedicated_renderer(asset, device=device, sampling="engine")
        np.testing.assert_array_equal(renderer.render(camera, (0, 0, 0)).visible, wanted)
        renderer.close()
