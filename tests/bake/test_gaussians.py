"""Bakes of Gaussians: their views, backgrounds, and a surface from their own depths."""

from pathlib import Path

import numpy as np
import pytest

import msb
from msb.bake import candidate_surface, vertex_descent
from msb.bake.depth_fusion import NativeDepthRenderer
from msb.bake.views import choose_bake_views
from msb.scenes import Camera
from msb.splats.gaussians import Gaussians
from tests.splats import builders

FLOATERS = 40


@pytest.fixture(scope="module")
def splats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a PLY of a ball of radius 1 with colours by height, and of faint floaters around it."""
    count = 1500
    height = np.linspace(-1, 1, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    level = np.sqrt(1 - height**2)
    skin = np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)
    random = np.random.default_rng(0)
    stray = random.normal(size=(FLOATERS, 3))
    stray *= 8 / np.linalg.norm(stray, axis=1, keepdims=True)
    mean = np.concatenate([skin, stray]).astype(np.float32)
    color = np.stack([mean[:, 1], -mean[:, 1], 0 * mean[:, 1]], axis=1).clip(-1, 1)
    model = Gaussians(
        mean=mean,
        scale=np.full(mean.shape, np.log(0.04), np.float32),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (len(mean), 1)),
        opacity=np.concatenate([np.full(count, 4), np.full(FLOATERS, -3)]).astype(np.float32),
        f_dc=color.astype(np.float32),
        f_rest=None,
    )
    path = tmp_path_factory.mktemp("splats") / "ball.ply"
    path.write_bytes(builders.ply(model))
    return path


@pytest.mark.slow
def test_generated_views_show_the_dense_part_over_two_greys(splats: Path) -> None:
    views = choose_bake_views(msb.open(splats))
    assert len(views.all_but_test) + len(views.test) == 48
    assert views.origin == "turntable"
    for part in (views.training, views.test):
        assert {views.background_of(camera) for camera in part} == {(0.3,) * 3, (0.7,) * 3}
    # The ball is framed, not the floaters: all cameras are near it and see it whole.
    for camera in views.test:
        distance = float(np.linalg.norm(camera.center))
        extent = camera.fy / np.sqrt(distance**2 - 1)
        assert 0.6 * camera.height < 2 * extent < 1.1 * camera.height


@pytest.mark.slow
def test_a_chosen_background_is_kept(splats: Path) -> None:
    views = choose_bake_views(msb.open(splats), background="white")
    assert {views.background_of(camera) for camera in views.test} == {(1.0, 1.0, 1.0)}


@pytest.mark.slow
def test_depths_are_those_of_the_nearest_skin(splats: Path) -> None:
    camera = Camera.look_at((0, 0, -4), (0, 0, 0), up=(0, 1, 0), width=64, height=64, fov_y=0.6)
    renderer = NativeDepthRenderer(msb.open(splats))
    depth = renderer.read_depth(camera)
    renderer.close()
    assert depth[0, 0] == 0
    assert depth[32, 32] * camera.unit == pytest.approx(3, abs=0.05)


@pytest.mark.slow
def test_auto_makes_a_closed_surface(splats: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidate_surface, "CELLS", 48)
    monkeypatch.setattr(vertex_descent, "STEPS", 20)
    report = msb.bake(splats, faces=800, texture=128).report
    assert (report.geometry, report.before) == ("surface", None)
    assert report.after.level == "ok"
    assert report.sentence.endswith("no mesh before")
    quality = report.native
    assert quality is not None
    assert quality.before is None
    assert quality.model_only_16 is not None
    assert 22 < quality.model_only_16 < quality.after_16
    assert quality.after_16 > 28
    assert report.to_dict()["verdict_before"] is None
