"""What the standard tier takes from an asset, and what it refuses."""

from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.asset.sh import SH_C0
from msb.cl import Device
from msb.errors import Unsupported
from msb.render.standard.renderer import StandardRenderer
from tests.reference.soups import random_triangles, soup
from tests.render.standard_scenes import BACKGROUND, camera, draw, mesh_asset, random_colors, scene, twin


def two_dts(count: int, **settings: Any) -> Asset:
    triangles = random_triangles(1, count, 1.0)
    opacity = np.linspace(-3, 3, count).astype(np.float32)
    return soup("two_dts", triangles, seed=1, opacity=opacity, **settings)


def test_zeroth_coefficient_is_baked(styled: Device) -> None:
    asset = two_dts(60)
    colors = np.clip(SH_C0 * asset.buffers["f_dc"].reshape(60, 3) + 0.5, 0, 1)
    view = camera()
    frame = draw(styled, asset, view, ste_threshold=None)
    mesh = asset.buffers["positions"], asset.buffers["indices"]
    expected = twin(mesh, colors, view, "face")
    same = frame.face_id == expected.face_id
    assert same.mean() > 0.999
    np.testing.assert_allclose(frame.image[same], expected.image[same], atol=1e-6)


def test_hidden_faces_keep_numbers(styled: Device) -> None:
    asset = two_dts(60)
    view = camera()
    everything = draw(styled, asset, view, ste_threshold=None)
    half = draw(styled, asset, view, ste_threshold=0.5)  # sigmoid(x) > 0.5 where x > 0: faces 30 to 59
    assert {*np.unique(half.face_id)} <= {-1, *range(30, 60)}
    kept = everything.face_id >= 30
    assert kept.any()
    np.testing.assert_array_equal(half.face_id[kept], everything.face_id[kept])
    none = draw(styled, asset, view, ste_threshold=1.0)
    assert not none.alpha.any()
    np.testing.assert_array_equal(none.image, np.broadcast_to(np.float32(BACKGROUND), none.image.shape))


def test_takes_coordinates_whose_sum_overflows(styled: Device) -> None:
    positions, indices = scene("small", 0)
    positions[:3] = np.finfo(np.float32).max
    frame = draw(styled, mesh_asset((positions, indices)), camera())
    assert np.isfinite(frame.image).all()
    assert frame.alpha.any()


def test_samples_are_an_option_of_the_standard_tier_alone(cpu: Device) -> None:
    """MeshSplatting's setting of that name is its own look's, and does nothing here."""
    asset = soup("mesh_splatting", random_triangles(1, 20), welded=True)
    plain = draw(cpu, asset, camera())
    own = msb.render(asset, camera(), "standard", BACKGROUND, {"supersample": 2}, cpu)
    np.testing.assert_array_equal(plain.image, own.image)
    with pytest.raises(Unsupported, match="UNSUPPORTED_OPTION"):
        msb.render(asset, camera(), "dedicated", device=cpu, supersample=2)


@pytest.mark.slow
def test_image_alone_is_that_of_the_frame(styled: Device) -> None:
    mesh = scene("everything", 5)
    renderer = StandardRenderer(mesh_asset(mesh, random_colors(5, len(mesh[0]))), device=styled)
    frame = renderer.render(camera(), BACKGROUND)
    out = np.zeros_like(frame.image)
    assert renderer.render_image(camera(), BACKGROUND, out) is out
    np.testing.assert_array_equal(out, frame.image)
    np.testing.assert_array_equal(renderer.render_image(camera(), BACKGROUND), frame.image)
    frame.image[:] = frame.depth[:] = 7
    again = renderer.render(camera(), BACKGROUND, out=frame)
    assert again.image is frame.image
    np.testing.assert_array_equal(again.image, out)
    assert not (again.depth == 7).any()
    renderer.close()


def test_asset_may_go_once_the_renderer_is_made(styled: Device) -> None:
    """The upload may share memory of the asset."""
    asset = mesh_asset(scene("small", 9))
    renderer = StandardRenderer(asset, device=styled)
    before = renderer.render(camera(), BACKGROUND)
    del asset
    np.testing.assert_array_equal(renderer.render(camera(), BACKGROUND).image, before.image)
    renderer.close()
