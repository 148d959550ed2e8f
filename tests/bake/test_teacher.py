"""What teaches is what the method draws, or the photographs as compared; pictures are kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.asset import build_asset
from msb.bake.cache import SUFFIX
from msb.bake.lessons import Lessons
from msb.bake.teacher import SAMPLES, Teacher
from msb.bake.views import BakeViews, bake_views
from msb.metrics.ground_truth import ground_truth
from msb.scenes import Camera
from tests.bake.conftest import solid
from tests.bake.soups import MODELS, SCENE, ring

Image = NDArray[np.float32]
STEP = 1 / 65535


def test_a_model_is_taught_by_its_dedicated_tier_at_both_sizes() -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    views = bake_views(asset, SCENE)
    with Teacher(asset, views) as teacher:
        for scale in (1, 2):
            with teacher.lessons(views.held_back[:1], scale) as lessons:
                image = lessons.image(0)
            camera = views.held_back[0].scaled(scale)
            frame = msb.render(asset, camera, tier="dedicated", background=views.background, outputs=())
            assert np.abs(image - frame.image.clip(0, 1)).max() <= STEP


def test_a_plain_mesh_is_taught_by_itself_with_samples() -> None:
    asset = solid()
    views = bake_views(asset, cameras=ring(3))
    with Teacher(asset, views) as teacher, teacher.lessons(views.taught) as lessons:
        drawn = msb.render(asset, views.taught[1], supersample=SAMPLES).image
        assert np.abs(lessons.image(1) - drawn).max() <= STEP


def test_photographs_teach_as_they_are_compared_and_never_larger() -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    views = bake_views(asset, SCENE, photographs=True)
    with Teacher(asset, views, "photographs") as teacher, teacher.lessons(views.taught[:1], 2) as lessons:
        assert np.abs(lessons.image(0) - ground_truth(views.scene, views.taught[0])).max() <= STEP


def test_halves_show_what_cameras_of_half_the_size_see_wherever_their_pixels_lie() -> None:
    """Of a picture in which brightness rises evenly the mean of four pixels is what lies in their middle."""

    def even(camera: Camera) -> Image:
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        right, down = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
        return np.stack([0.5 + right, 0.5 + down, 0.5 + right * 0], axis=2).astype(np.float32)

    cameras = [Camera(12, 9, 20.0, 22.0, 5.5, 4.0, np.eye(4)), Camera(7, 10, 20.0, 20.0, 3.0, 6.0, np.eye(4))]
    with Lessons(cameras, (0, 0, 0), even) as lessons:
        both = lessons.with_halves(100)
        assert both.cameras[:2] == lessons.cameras
        assert [(each.width, each.height) for each in both.cameras[2:4]] == [(6, 4), (5, 4)]
        assert len({(each.cx % 1, each.cy % 1) for each in both.cameras[2:]}) == 4
        for number, camera in enumerate(both.cameras):
            assert np.abs(both.image(number) - even(camera)).max() <= 2 * STEP
        assert lessons.within(100).cameras[0] == both.cameras[2]
        assert len(lessons.with_halves(19)) == 2 + 4 + 8
        assert both.weights == (1, 1, 2, 2, 2, 2)
    with Lessons([cameras[0]] * 32, (0, 0, 0), even) as many:
        both = many.with_halves(30)
        assert both.weights == (1,) * 32 + (4,) * 32
        assert len({(each.cx, each.cy) for each in both.cameras[32:]}) == 4
    with Lessons([Camera(12, 2, 20.0, 20.0, 6.0, 1.0, np.eye(4))], (0, 0, 0), even) as thin:
        assert thin.with_halves(1).cameras == thin.cameras


@pytest.fixture
def views() -> BakeViews:
    return replace(bake_views(solid(), cameras=ring(3)), between=())


def taught(folder: Path, views: BakeViews, asset: msb.Asset | None = None) -> tuple[np.ndarray, list[str]]:
    with Teacher(asset or solid(), views, cache=folder) as teacher, teacher.looks(views.taught) as looks:
        images = np.stack([looks.stored(number) for number in range(len(looks))])
        return images, teacher.pictures.notes()


def test_a_second_bake_draws_nothing(
    views: BakeViews, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, notes = taught(tmp_path / "cache", views)
    assert notes == []
    monkeypatch.setattr(Teacher, "_look", None)
    again, notes = taught(tmp_path / "cache", views)
    np.testing.assert_array_equal(again, first)
    assert "2 of 2" in notes[0]


def test_what_is_seen_otherwise_is_drawn(views: BakeViews, tmp_path: Path) -> None:
    taught(tmp_path, views)
    asset = solid()
    colors = {**asset.buffers, "color": asset.buffers["color"][::-1].copy()}
    larger = {**asset.buffers, "positions": 2 * asset.buffers["positions"]}
    moved = tuple(camera.scaled(2) for camera in views.taught)
    for other, shown in (
        (views, replace(asset, buffers=colors)),  # whose manifest has the hashes of what it was
        (views, build_asset(larger, {"color": "vertex"})),
        (replace(views, background=(0.0, 0.5, 1.0)), asset),
        (replace(views, teaching=moved, aside=()), asset),
    ):
        _, notes = taught(tmp_path, other, shown)
        assert notes == []


@pytest.mark.parametrize("damage", ["cut", "longer", "another", "empty"])
def test_a_damaged_picture_is_drawn_again(views: BakeViews, tmp_path: Path, damage: str) -> None:
    first, _ = taught(tmp_path, views)
    place, _ = sorted(tmp_path.glob(f"*{SUFFIX}"))
    data = place.read_bytes()
    broken = {"cut": data[:-1], "longer": data + b"1", "another": data[:-1] + b"\xfe", "empty": b""}
    place.write_bytes(broken[damage])
    again, notes = taught(tmp_path, views)
    np.testing.assert_array_equal(again, first)
    assert "1 of 2" in notes[0]
    assert place.read_bytes() == data
