"""What teaches is what the method draws, or the photographs as they are compared."""

import numpy as np
from numpy.typing import NDArray

import msb
from msb.bake.lessons import Lessons
from msb.bake.teacher import SAMPLES, Teacher
from msb.bake.views import bake_views
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.metrics.ground_truth import ground_truth
from msb.scenes import Camera
from tests.bake.test_views import MODELS, SCENE, ring
from tests.conftest import TETRAHEDRON

Image = NDArray[np.float32]
STEP = 1 / 65535


def mesh_asset() -> msb.Asset:
    points, faces = TETRAHEDRON
    colors = np.linspace(0.1, 0.9, 12, dtype=np.float32).reshape(4, 3)
    return asset_from_mesh(Mesh(points, faces.astype(np.int64), vertex_colors=colors))


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
    asset = mesh_asset()
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
