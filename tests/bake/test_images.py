"""Training images: native renderings or photographs, their halved copies, and the image cache."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.asset import build_asset
from msb.bake.image_cache import SUFFIX
from msb.bake.image_source import SAMPLES_PER_SIDE, ImageSource
from msb.bake.images import ViewImages
from msb.bake.views import BakeViews, choose_bake_views
from msb.metrics.ground_truth import ground_truth
from msb.scenes import Camera
from tests.bake.conftest import solid
from tests.bake.soups import MODELS, SCENE, ring

Image = NDArray[np.float32]
STEP = 1 / 65535


def test_native_renderings_are_of_the_dedicated_tier_at_all_scales() -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    views = choose_bake_views(asset, SCENE)
    with ImageSource(asset, views) as source:
        for scale in (1, 2):
            with source.training_images(views.test[:1], scale) as images:
                image = images.image(0)
            camera = views.test[0].scaled(scale)
            frame = msb.render(asset, camera, tier="dedicated", background=views.background, outputs=())
            assert np.abs(image - frame.image.clip(0, 1)).max() <= STEP


def test_a_mesh_file_is_rendered_on_the_standard_tier_with_16_samples() -> None:
    asset = solid()
    views = choose_bake_views(asset, cameras=ring(3))
    with ImageSource(asset, views) as source, source.training_images(views.all_but_test) as images:
        expected = msb.render(asset, views.all_but_test[1], supersample=SAMPLES_PER_SIDE).image
        assert np.abs(images.image(1) - expected).max() <= STEP


def test_photographs_are_those_of_metrics_and_never_scaled() -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    views = choose_bake_views(asset, SCENE, photographs=True)
    source = ImageSource(asset, views, "photographs")
    with source, source.training_images(views.all_but_test[:1], 2) as images:
        expected = ground_truth(views.scene, views.all_but_test[0])
        assert np.abs(images.image(0) - expected).max() <= STEP


def test_halved_images_show_the_view_of_cameras_of_half_the_size() -> None:
    """In an image of linear brightness, the average of four pixels is the brightness at their centre."""

    def draw_ramp(camera: Camera) -> Image:
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        right, down = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
        return np.stack([0.5 + right, 0.5 + down, 0.5 + right * 0], axis=2).astype(np.float32)

    cameras = [Camera(12, 9, 20.0, 22.0, 5.5, 4.0, np.eye(4)), Camera(7, 10, 20.0, 20.0, 3.0, 6.0, np.eye(4))]
    with ViewImages(cameras, (0, 0, 0), draw_ramp) as images:
        levels = images.with_coarser_levels(100)
        assert levels.cameras[:2] == images.cameras
        assert [(camera.width, camera.height) for camera in levels.cameras[2:4]] == [(6, 4), (5, 4)]
        assert len({(camera.cx % 1, camera.cy % 1) for camera in levels.cameras[2:]}) == 4
        for number, camera in enumerate(levels.cameras):
            assert np.abs(levels.image(number) - draw_ramp(camera)).max() <= 2 * STEP
        assert images.limited_to(100).cameras[0] == levels.cameras[2]
        assert len(images.with_coarser_levels(19)) == 2 + 4 + 8
        assert levels.weights == (1, 1, 2, 2, 2, 2)
    with ViewImages([cameras[0]] * 32, (0, 0, 0), draw_ramp) as many:
        levels = many.with_coarser_levels(30)
        assert levels.weights == (1,) * 32 + (4,) * 32
        assert len({(camera.cx, camera.cy) for camera in levels.cameras[32:]}) == 4
    with ViewImages([Camera(12, 2, 20.0, 20.0, 6.0, 1.0, np.eye(4))], (0, 0, 0), draw_ramp) as thin:
        assert thin.with_coarser_levels(1).cameras == thin.cameras


@pytest.fixture
def views() -> BakeViews:
    return replace(choose_bake_views(solid(), cameras=ring(3)), interpolated=())


def render(folder: Path, views: BakeViews, asset: msb.Asset | None = None) -> tuple[np.ndarray, list[str]]:
    """Return the native renderings of all views with a cache in `folder`, and the notes of the cache."""
    source = ImageSource(asset or solid(), views, cache=folder)
    with source, source.native_images(views.all_but_test) as images:
        stored = [images.stored_image(number) for number in range(len(images))]
        return np.stack(stored), source.cache.notes()


def test_cached_images_are_reused(views: BakeViews, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, notes = render(tmp_path / "cache", views)
    assert notes == []
    monkeypatch.setattr(ImageSource, "_render", None)
    again, notes = render(tmp_path / "cache", views)
    np.testing.assert_array_equal(again, first)
    assert "2 of 2" in notes[0]


def test_other_models_and_views_are_rendered(views: BakeViews, tmp_path: Path) -> None:
    render(tmp_path, views)
    asset = solid()
    colors = {**asset.buffers, "color": asset.buffers["color"][::-1].copy()}
    larger = {**asset.buffers, "positions": 2 * asset.buffers["positions"]}
    scaled = tuple(camera.scaled(2) for camera in views.all_but_test)
    for other, model in (
        (views, replace(asset, buffers=colors)),  # the manifest still has the hashes of the old buffers
        (views, build_asset(larger, {"color": "vertex"})),
        (replace(views, background=(0.0, 0.5, 1.0)), asset),
        (replace(views, training=scaled, validation=()), asset),
    ):
        _, notes = render(tmp_path, other, model)
        assert notes == []


@pytest.mark.parametrize("damage", ["cut", "longer", "changed", "empty"])
def test_a_damaged_image_is_rendered_again(views: BakeViews, tmp_path: Path, damage: str) -> None:
    first, _ = render(tmp_path, views)
    place, _ = sorted(tmp_path.glob(f"*{SUFFIX}"))
    data = place.read_bytes()
    damaged = {"cut": data[:-1], "longer": data + b"1", "changed": data[:-1] + b"\xfe", "empty": b""}
    place.write_bytes(damaged[damage])
    again, notes = render(tmp_path, views)
    np.testing.assert_array_equal(again, first)
    assert "1 of 2" in notes[0]
    assert place.read_bytes() == data
