"""The views of a bake: none both teaches and is measured on, and those that see nothing are refused."""

from __future__ import annotations

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
from msb.scenes import read_cameras
from msb.scenes.datasets import read_scene
from msb.scenes.paths import turntable
from tests.conftest import ROOT, TETRAHEDRON

MODELS = ROOT / "data_stubs" / "models"
SCENE = ROOT / "data_stubs" / "scenes" / "nerf_synthetic" / "pebble"


@pytest.fixture(scope="module")
def solid() -> msb.Asset:
    points, faces = TETRAHEDRON
    return asset_from_mesh(Mesh(points, faces.astype(np.int64)))


def ring(count: int, width: int = 48, height: int = 36, z: float = 0.2) -> list[msb.Camera]:
    middle = (0.2, 0.2, z)
    return turntable(middle, 4.0, up=(0, 0, 1), count=count, width=width, height=height, fov_y=0.6)


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
    assert views.said.endswith("+z up")
    assert not views.notes
    # Without the option, what is taken for up is said.
    assert "+y is taken for it; --up" in bake_views(solid).notes[0]


def test_a_room_is_looked_at_from_inside() -> None:
    asset = replace(msb.open(MODELS / "walled" / "diffsoup"), opened_from=None)
    views = bake_views(asset)
    assert views.origin == "inside"
    assert are_apart(views)


@pytest.mark.slow
def test_views_of_many_pixels_teach_scaled(solid: msb.Asset) -> None:
    views = bake_views(solid, cameras=[*ring(7), *ring(1, 4000, 3000)])
    assert max(camera.width * camera.height for camera in views.taught) <= 1.001 * MOST_PIXELS
    assert views.notes == ("1 of 8 views teach scaled, such as from 4000 x 3000 to 1182 x 887 pixels",)


def test_what_sees_nothing_is_refused_and_does_not_count(solid: msb.Asset) -> None:
    blind = ring(2, z=90.0)
    with pytest.raises(MetricError, match=r"no camera sees the mesh \(2 cameras given\)"):
        bake_views(solid, cameras=blind)
    views = bake_views(solid, cameras=[*ring(4), *blind])
    assert [len(part) for part in (views.teaching, views.aside, views.held_back)] == [2, 1, 1]
    assert "2 see none of it" in views.said


def test_a_scene_that_the_model_is_not_of_is_refused(solid: msb.Asset) -> None:
    points, faces = TETRAHEDRON
    away = asset_from_mesh(Mesh(points + np.float32(1000), faces.astype(np.int64)))
    with pytest.raises(MetricError, match=r"no camera sees the mesh .*training views of pebble"):
        bake_views(away, SCENE)


def test_what_is_no_scene_and_what_lacks_photographs(tmp_path: Path) -> None:
    asset = msb.open(MODELS / "pebble" / "triangle_splatting")
    with pytest.raises(SceneError):
        bake_views(asset, tmp_path)
    with pytest.raises(UsageError, match="give one of them"):
        bake_views(asset, SCENE, ring(2))
    with pytest.raises(UsageError, match="cameras is empty"):
        bake_views(asset, cameras=[])
    shutil.copytree(SCENE, tmp_path / "pebble")
    kept = bake_views(asset, tmp_path / "pebble", photographs=True)
    for camera in kept.taught[3:]:
        camera.image_path.unlink()
    few = bake_views(asset, tmp_path / "pebble", photographs=True)
    assert poses(few.taught) == poses(kept.taught[:3])
    for camera in kept.taught[:3]:
        camera.image_path.unlink()
    with pytest.raises(UsageError, match="no photographs of its training views"):
        bake_views(asset, tmp_path / "pebble", photographs=True)


def test_the_cameras_of_a_file_are_taken_as_they_are() -> None:
    cameras = read_cameras(ROOT / "data_stubs" / "views.json")
    asset = msb.open(ROOT / "data_stubs" / "checkpoint")
    views = bake_views(asset, cameras=cameras)
    sizes = {(camera.width, camera.height) for camera in (*views.taught, *views.held_back)}
    assert sizes == {(camera.width, camera.height) for camera in cameras}
