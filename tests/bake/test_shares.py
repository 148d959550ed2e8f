"""Shares of faces over several lessons, of blended and of opaque models."""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.bake.lessons import Lessons
from msb.bake.shares import blending_shares
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.methods.diffsoup.look import Pipeline
from msb.render.splat.pipeline import SplattingPipeline
from msb.scenes import Camera
from tests.cl.conftest import SELECTOR
from tests.reference.soups import front_camera, random_triangles, soup

CAMERAS = front_camera(), front_camera(33, 40)


def noise(camera: Camera) -> np.ndarray:
    return np.random.default_rng(camera.width).random((camera.height, camera.width, 3), np.float32)


@pytest.fixture
def lessons() -> Any:
    with Lessons(CAMERAS, (0.0, 0.0, 0.0), noise) as made:
        yield made


def test_shares_of_a_blended_model_are_sums_over_the_views(lessons: Lessons) -> None:
    asset = soup("triangle_splatting", random_triangles(1))
    with closing(SplattingPipeline(asset, device=SELECTOR)) as pipeline:
        sums = sum(pipeline.shares(camera, lessons.image(k)) for k, camera in enumerate(CAMERAS))
    shares = blending_shares(asset, lessons, SELECTOR)
    assert shares is not None
    np.testing.assert_array_equal(shares.weight, sums[:, 3])
    np.testing.assert_allclose(shares.color * shares.weight[:, None], sums[:, :3], rtol=1e-12)
    unseen = shares.weight == 0
    assert 0 < unseen.sum() < 40
    assert (shares.color[unseen] == 0.5).all()


def of_a_mesh() -> Asset:
    triangles = random_triangles(1)
    return asset_from_mesh(Mesh(triangles.reshape(-1, 3), np.arange(180).reshape(-1, 3)))


@pytest.mark.parametrize(
    ("asset", "tier"), [(soup("diffsoup", random_triangles(1)), "dedicated"), (of_a_mesh(), "standard")]
)
def test_shares_of_an_opaque_model_are_the_pixels_it_shows(asset: Asset, tier: Any, lessons: Lessons) -> None:
    shares = blending_shares(asset, lessons, SELECTOR)
    assert shares is not None
    pixels, sums = np.zeros(60), np.zeros((60, 3))
    for k, camera in enumerate(CAMERAS):
        frame = msb.render(asset, camera, tier=tier, device=SELECTOR)
        for face, color in zip(frame.face_id.ravel(), lessons.image(k).reshape(-1, 3), strict=True):
            if face >= 0:
                pixels[face] += 1
                sums[face] += color
    assert 5 < (pixels > 0).sum() < 60
    np.testing.assert_array_equal(shares.weight, pixels)
    np.testing.assert_allclose(shares.color * pixels[:, None], sums, rtol=1e-9)
    assert (shares.color[pixels == 0] == 0.5).all()


def test_a_look_that_does_not_say_which_face_a_pixel_shows_has_none(
    lessons: Lessons, monkeypatch: pytest.MonkeyPatch
) -> None:
    render = Pipeline.render
    monkeypatch.setattr(Pipeline, "render", lambda *of: replace(render(*of), face_id=None))
    assert blending_shares(soup("diffsoup", random_triangles(1)), lessons, SELECTOR) is None
