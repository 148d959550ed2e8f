"""The views of a bake: disjoint training, validation and test views, which all see the asset."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.bake.views import MAX_PIXELS, RING_BELOW, RINGS, BakeViews, choose_bake_views
from msb.errors import MetricError, SceneError, UsageError
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.scenes import turntable
from msb.scenes.datasets import read_scene
from tests.bake.soups import MODELS, SCENE, ball, ring
from tests.conftest import TETRAHEDRON


@pytest.fixture(scope="module")
def solid() -> msb.Asset:
    points, faces = TETRAHEDRON
    return asset_from_mesh(Mesh(points, faces.astype(np.int64)))


def poses(cameras: tuple[msb.Camera, ...]) -> set[bytes]:
    return {camera.world_to_camera.tobytes() for camera in cameras}


def are_disjoint(views: BakeViews) -> bool:
    parts = [poses(part) for part in (views.training, views.interpolated, views.validation, views.test)]
    return sum(map(len, parts)) == len(set().union(*parts))


def test_views_of_a_scene_keep_its_split() -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    views = choose_bake_views(asset, SCENE)
    scene = read_scene(SCENE)
    assert poses(views.test) == poses(scene.test)
    assert poses((*views.training, *views.validation)) == poses(scene.train)
    assert len(views.validation) == -(-len(scene.train) // 8)
    assert are_disjoint(views)
    assert (views.origin, views.background) == ("scene", scene.background)
    assert choose_bake_views(asset, SCENE, background="black").scene.background == (0, 0, 0)
    assert all(camera.image_path.is_file() for camera in views.test)


def test_every_eighth_camera_is_held_out(solid: msb.Asset) -> None:
    views = choose_bake_views(solid, cameras=iter(ring(24)))
    assert [len(part) for part in (views.training, views.validation, views.test)] == [18, 3, 3]
    assert are_disjoint(views)
    assert (views.origin, views.background) == ("given", (0, 0, 0))


@pytest.mark.parametrize(("count", "parts"), [(1, (1, 0, 0)), (2, (1, 0, 1)), (3, (2, 0, 1)), (4, (2, 1, 1))])
def test_few_cameras_are_training_views_first(solid: msb.Asset, count: int, parts: tuple[int, ...]) -> None:
    views = choose_bake_views(solid, cameras=ring(count))
    assert tuple(len(part) for part in (views.training, views.validation, views.test)) == parts


def test_few_views_are_completed_by_interpolated_ones(solid: msb.Asset) -> None:
    for count, interpolated in ((1, 0), (2, 0), (3, 8), (16, 26), (44, 2), (48, 0)):
        assert len(choose_bake_views(solid, cameras=ring(count)).interpolated) == interpolated
    views = choose_bake_views(solid, cameras=ring(24))
    assert views.all_but_test == (*views.training, *views.interpolated, *views.validation)
    assert are_disjoint(views)
    asset, scene = msb.open(MODELS / "pebble" / "triangle_splatting"), read_scene(SCENE)
    assert len(choose_bake_views(asset, scene).all_but_test) == 40
    # Photographs cannot be interpolated.
    assert choose_bake_views(asset, scene, photographs=True).interpolated == ()


def test_all_training_cameras_are_used() -> None:
    asset = msb.open(MODELS / "walled" / "mesh_splatting")
    views = choose_bake_views(asset)
    assert (views.origin, len(views.all_but_test) + len(views.test)) == ("training", 57)
    assert are_disjoint(views)


def test_generated_views_of_a_mesh_are_at_four_heights(solid: msb.Asset) -> None:
    views = choose_bake_views(solid, up="+z")
    every = (*views.all_but_test, *views.test)
    assert (views.origin, len(every)) == ("turntable", 52)
    assert are_disjoint(views)
    middle = np.asarray(solid.manifest.bounding_sphere.center)
    heights = [camera.center - middle for camera in every]
    degrees = [round(float(np.degrees(np.arcsin(away[2] / np.linalg.norm(away))))) for away in heights]
    assert {angle: degrees.count(angle) for angle in degrees} == {
        int(angle): n for angle, n in (*RINGS, RING_BELOW)
    }
    assert (len(views.notes), len(choose_bake_views(solid).notes)) == (0, 1), "an assumed axis is noted"


def test_a_room_gets_views_from_inside() -> None:
    asset = replace(msb.open(MODELS / "walled" / "diffsoup"), opened_from=None)
    views = choose_bake_views(asset)
    assert views.origin == "inside"
    assert are_disjoint(views)


def test_the_kind_of_generated_views_can_be_chosen(solid: msb.Asset) -> None:
    asset = asset_from_mesh(ball(4))
    outside, inside, both = (choose_bake_views(asset, kind=kind) for kind in ("outside", "inside", "both"))
    assert (outside.origin, inside.origin, both.origin) == ("turntable", "inside", "both")
    counts = [len((*views.all_but_test, *views.test)) for views in (outside, inside, both)]
    assert counts == [52, 52, 104]
    assert are_disjoint(both)
    assert both.is_generated
    for given in ({"cameras": ring(4)}, {"scene": SCENE}):
        with pytest.raises(UsageError):
            choose_bake_views(solid, **given, kind="outside")
    # Requested views replace the training cameras beside the model.
    assert choose_bake_views(msb.open(MODELS / "walled" / "mesh_splatting"), kind="inside").origin == "inside"


def test_far_outliers_do_not_move_generated_views(solid: msb.Asset) -> None:
    points, faces = TETRAHEDRON
    stray = np.float32(50) + 0.1 * np.eye(3, dtype=np.float32)
    both = np.concatenate([points, stray]), np.concatenate([faces, np.arange(3)[None] + len(points)])
    views = choose_bake_views(asset_from_mesh(Mesh(both[0], both[1].astype(np.int64))), up="+z")
    assert poses(views.test) == poses(choose_bake_views(solid, up="+z").test)


@pytest.mark.slow
def test_nothing_is_judged_where_the_model_is_a_speck(solid: msb.Asset) -> None:
    assert choose_bake_views(solid, cameras=ring(4)).why_not_judged is None
    far = turntable((0.2, 0.2, 0.2), 60.0, up=(0, 0, 1), count=4, width=96, height=72, fov_y=0.6)
    assert choose_bake_views(solid, cameras=far).why_not_judged
    report = msb.bake(solid, cameras=far, geometry="kept", color="vertex").report
    assert (report.native, report.test) == (None, 1)
    assert any("quality was not measured" in note for note in report.notes)


@pytest.mark.slow
def test_large_views_are_scaled_down(solid: msb.Asset) -> None:
    views = choose_bake_views(solid, cameras=[*ring(7), *ring(1, 4000, 3000)])
    assert max(camera.width * camera.height for camera in views.all_but_test) <= 1.001 * MAX_PIXELS
    assert len(views.notes) == 1
    assert "4000 x 3000 to 1182 x 887" in views.notes[0]


def test_blind_views_do_not_count(solid: msb.Asset) -> None:
    blind = ring(2, z=90.0)
    views = choose_bake_views(solid, cameras=[*ring(4), *blind])
    assert [len(part) for part in (views.training, views.validation, views.test)] == [2, 1, 1]
    points, faces = TETRAHEDRON
    away = asset_from_mesh(Mesh(points + np.float32(1000), faces.astype(np.int64)))
    for asset, seen_by in ((solid, {"cameras": blind}), (away, {"scene": SCENE})):
        with pytest.raises(MetricError) as caught:
            choose_bake_views(asset, **seen_by)
        assert caught.value.code == "METRIC_NOTHING_SHOWN"


def test_invalid_scenes_cameras_and_missing_photographs(tmp_path: Path) -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    with pytest.raises(SceneError):
        choose_bake_views(asset, tmp_path)
    for scene, cameras in ((SCENE, ring(2)), (None, [])):
        with pytest.raises(UsageError):
            choose_bake_views(asset, scene, cameras)
    shutil.copytree(SCENE, tmp_path / "pebble")
    whole = choose_bake_views(asset, tmp_path / "pebble", photographs=True)
    for camera in whole.all_but_test[3:]:
        camera.image_path.unlink()
    few = choose_bake_views(asset, tmp_path / "pebble", photographs=True)
    assert poses(few.all_but_test) == poses(whole.all_but_test[:3])
    for camera in whole.all_but_test[:3]:
        camera.image_path.unlink()
    with pytest.raises(UsageError):
        choose_bake_views(asset, tmp_path / "pebble", photographs=True)
