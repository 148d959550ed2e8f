"""The views of a bake: none both teaches and is measured on, and those that see nothing are refused."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.bake.views import BELOW, MOST_PIXELS, RINGS, BakeViews, bake_views
from msb.errors import MetricError, SceneError, UsageError
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.scenes.datasets import read_scene
from tests.bake.soups import MODELS, SCENE, ring
from tests.conftest import TETRAHEDRON


@pytest.fixture(scope="module")
def solid() -> msb.Asset:
    points, faces = TETRAHEDRON
    return asset_from_mesh(Mesh(points, faces.astype(np.int64)))


def poses(cameras: tuple[msb.Camera, ...]) -> set[bytes]:
    return {camera.world_to_camera.tobytes() for camera in cameras}


def are_apart(views: BakeViews) -> bool:
    parts = [poses(part) for part in (views.teaching, views.between, views.aside, views.held_back)]
    return sum(map(len, parts)) == len(set().union(*parts))


def test_training_views_of_a_scene_teach_and_its_test_views_are_held_back() -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    views = bake_views(asset, SCENE)
    scene = read_scene(SCENE)
    assert poses(views.held_back) == poses(scene.test)
    assert poses((*views.teaching, *views.aside)) == poses(scene.train)
    assert len(views.aside) == -(-len(scene.train) // 8)
    assert are_apart(views)
    assert (views.origin, views.background) == ("scene", scene.background)
    assert bake_views(asset, SCENE, background="black").scene.background == (0, 0, 0)
    # What is held back is what `msb run` evaluates, photographs and all.
    assert all(camera.image_path.is_file() for camera in views.held_back)


def test_of_cameras_every_eighth_is_held_back(solid: msb.Asset) -> None:
    views = bake_views(solid, cameras=iter(ring(24)))
    assert [len(part) for part in (views.teaching, views.aside, views.held_back)] == [18, 3, 3]
    assert are_apart(views)
    assert (views.origin, views.background) == ("given", (0, 0, 0))


@pytest.mark.parametrize(("count", "parts"), [(1, (1, 0, 0)), (2, (1, 0, 1)), (3, (2, 0, 1)), (4, (2, 1, 1))])
def test_few_cameras_teach_first(solid: msb.Asset, count: int, parts: tuple[int, ...]) -> None:
    views = bake_views(solid, cameras=ring(count))
    assert tuple(len(part) for part in (views.teaching, views.aside, views.held_back)) == parts


def test_where_few_views_teach_those_between_them_do_as_well(solid: msb.Asset) -> None:
    for count, made in ((1, 0), (2, 0), (3, 8), (16, 26), (44, 2), (48, 0)):
        assert len(bake_views(solid, cameras=ring(count)).between) == made
    views = bake_views(solid, cameras=ring(24))
    assert views.taught == (*views.teaching, *views.between, *views.aside)
    assert are_apart(views)
    asset, scene = msb.open(MODELS / "pebble" / "triangle_splatting"), read_scene(SCENE)
    assert len(bake_views(asset, scene).taught) == 40
    # There are no photographs of where nobody stood.
    assert bake_views(asset, scene, photographs=True).between == ()


def test_all_cameras_of_the_training_are_taken(tmp_path: Path) -> None:
    asset = msb.open(MODELS / "walled" / "mesh_splatting")
    views = bake_views(asset)
    assert (views.origin, len(views.taught) + len(views.held_back)) == ("training", 57)
    assert are_apart(views)


def test_made_views_of_a_mesh_are_at_four_heights_and_apart(solid: msb.Asset) -> None:
    views = bake_views(solid, up="+z")
    every = (*views.taught, *views.held_back)
    assert (views.origin, len(every)) == ("turntable", 52)
    assert are_apart(views)
    middle = np.asarray(solid.manifest.bounding_sphere.center)
    heights = [camera.center - middle for camera in every]
    degrees = [round(float(np.degrees(np.arcsin(away[2] / np.linalg.norm(away))))) for away in heights]
    assert {angle: degrees.count(angle) for angle in degrees} == {
        int(angle): n for angle, n in (*RINGS, BELOW)
    }
    assert (len(views.notes), len(bake_views(solid).notes)) == (0, 1), "an assumed axis is noted"


def test_a_room_is_looked_at_from_inside() -> None:
    asset = replace(msb.open(MODELS / "walled" / "diffsoup"), opened_from=None)
    views = bake_views(asset)
    assert views.origin == "inside"
    assert are_apart(views)


@pytest.mark.slow
def test_large_views_supervise_scaled(solid: msb.Asset) -> None:
    views = bake_views(solid, cameras=[*ring(7), *ring(1, 4000, 3000)])
    assert max(camera.width * camera.height for camera in views.taught) <= 1.001 * MOST_PIXELS
    assert len(views.notes) == 1
    assert "4000 x 3000 to 1182 x 887" in views.notes[0]


def test_blind_views_do_not_count(solid: msb.Asset) -> None:
    blind = ring(2, z=90.0)
    views = bake_views(solid, cameras=[*ring(4), *blind])
    assert [len(part) for part in (views.teaching, views.aside, views.held_back)] == [2, 1, 1]
    points, faces = TETRAHEDRON
    away = asset_from_mesh(Mesh(points + np.float32(1000), faces.astype(np.int64)))
    for asset, seen_by in ((solid, {"cameras": blind}), (away, {"scene": SCENE})):
        with pytest.raises(MetricError) as caught:
            bake_views(asset, **seen_by)
        assert caught.value.code == "METRIC_NOTHING_SHOWN"


def test_a_scene_or_cameras_are_needed_and_photographs_that_supervise(tmp_path: Path) -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    with pytest.raises(SceneError):
        bake_views(asset, tmp_path)
    for scene, cameras in ((SCENE, ring(2)), (None, [])):
        with pytest.raises(UsageError):
            bake_views(asset, scene, cameras)
    shutil.copytree(SCENE, tmp_path / "pebble")
    kept = bake_views(asset, tmp_path / "pebble", photographs=True)
    for camera in kept.taught[3:]:
        camera.image_path.unlink()
    few = bake_views(asset, tmp_path / "pebble", photographs=True)
    assert poses(few.taught) == poses(kept.taught[:3])
    for camera in kept.taught[:3]:
        camera.image_path.unlink()
    with pytest.raises(UsageError):
        bake_views(asset, tmp_path / "pebble", photographs=True)
