"""Scenes in each layout: cameras, split, sizes and warnings."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_stubs.captures import (
    dtu_cameras,
    mipnerf360_cameras,
    nerf_synthetic_cameras,
    tanksandtemples_cameras,
)
from msb.errors import InputError, SceneError
from msb.scenes import Camera, sorted_by_stem, stem
from msb.scenes.datasets import Scene, find_scenes, read_scene
from tests.conftest import ROOT
from tests.tiny.make import PEBBLE

from .bad_scenes import DTU, MIP
from .conftest import SCENES, STUBS, Copy, text_model

GOLDEN = ROOT / "tests/golden/metrics/scenes"
LOADERS: dict[str, Any] = json.loads((GOLDEN / "cameras.json").read_text())


def codes(scene: Scene) -> list[str]:
    return [warning.code for warning in scene.warnings if warning.code != "SCENE_UNKNOWN"]


def sizes(scene: Scene) -> set[tuple[int, int]]:
    return {(camera.width, camera.height) for camera in (*scene.train, *scene.test)}


@pytest.mark.parametrize(
    ("place", "layout", "size", "views", "masks", "resized"),
    [
        ("mipnerf360/pebble", "colmap", (64, 48), (14, 2), None, False),
        ("tanksandtemples/pebble", "colmap", (112, 80), (14, 2), None, False),
        ("nerf_synthetic/pebble", "blender", (72, 72), (12, 4), "png_alpha", True),
        ("dtu/scan1", "colmap", (72, 54), (14, 2), "png_alpha", True),
    ],
)
def test_a_scene_in_each_layout(
    place: str, layout: str, size: tuple[int, int], views: tuple[int, int], masks: str | None, resized: bool
) -> None:
    scene = read_scene(STUBS / place)
    assert (scene.dataset, scene.name) == tuple(place.split("/"))
    assert scene.layout == layout
    assert sizes(scene) == {size}
    assert (len(scene.train), len(scene.test)) == views
    assert scene.mask_source == masks
    assert scene.gt_resized is resized
    assert scene.background == ((1, 1, 1) if masks else (0, 0, 0))
    assert codes(scene) == []
    names = [camera.name for camera in (*scene.train, *scene.test)]
    assert len(set(names)) == sum(views)
    for camera in (*scene.train, *scene.test):
        assert camera.image_path == STUBS / place / scene.image_folder / str(camera.name)
        assert camera.image_path.is_file()
        assert (camera.cx, camera.cy) == (camera.width / 2, camera.height / 2)


@pytest.mark.parametrize(
    ("place", "originals"),
    [
        ("mipnerf360/pebble", mipnerf360_cameras(PEBBLE)),
        ("tanksandtemples/pebble", tanksandtemples_cameras(PEBBLE)),
        ("nerf_synthetic/pebble", [c for part in nerf_synthetic_cameras(PEBBLE).values() for c in part]),
        ("dtu/scan1", dtu_cameras(PEBBLE)),
    ],
)
def test_cameras_equal_the_cameras_of_the_photographs(place: str, originals: list[Camera]) -> None:
    scene = read_scene(STUBS / place)
    by_name = {str(camera.name).removesuffix(".png"): camera for camera in (*scene.train, *scene.test)}
    assert len(by_name) == len(originals)
    for wanted in originals:
        camera = by_name[str(wanted.name).removesuffix(".png")]
        np.testing.assert_allclose(camera.world_to_camera, wanted.world_to_camera, atol=1e-9)
        np.testing.assert_allclose((camera.fov_x, camera.fov_y), (wanted.fov_x, wanted.fov_y), rtol=1e-9)


def test_every_8th_by_stem_is_a_test_view() -> None:
    scene = read_scene(STUBS / "mipnerf360/pebble")
    assert [camera.name for camera in scene.test] == ["DSC07950.JPG", "DSC07958.JPG"]
    assert {camera.split for camera in scene.train} == {"train"}
    assert list(scene.train) == sorted_by_stem(scene.train)


def test_views_are_read_from_json_splits_not_from_folders() -> None:
    scene = read_scene(STUBS / "nerf_synthetic/pebble")
    files = {path.name for path in (STUBS / "nerf_synthetic/pebble/test").iterdir()}
    assert len(files) == 12  # including depths and normals
    assert [camera.name for camera in scene.test] == [f"test/r_{i}.png" for i in range(4)]


@pytest.mark.parametrize("key", [key for key in LOADERS["colmap_bin"] if key != "points3D"])
@pytest.mark.parametrize("layout", ["colmap_bin", "colmap_txt"])
def test_official_options_give_official_scenes(layout: str, key: str) -> None:
    _, folder, _, resolution = key.split()
    golden = LOADERS[layout][key]
    scene = read_scene(GOLDEN / layout, image_folder=folder, resolution=int(resolution))
    assert [stem(camera) for camera in scene.train] == golden["train"]
    assert [stem(camera) for camera in scene.test] == golden["test"]
    for wanted in golden.get("cameras", ()):
        (camera,) = (
            c for c in (*scene.test, *scene.train) if np.allclose(c.world_to_camera[:3, 3], wanted["T"])
        )
        assert (camera.width, camera.height) == (wanted["width"], wanted["height"])
        assert (camera.fov_x, camera.fov_y) == pytest.approx((wanted["FoVx"], wanted["FoVy"]), abs=1e-12)
    if "sizes" in golden:
        assert sizes(scene) == {tuple(size) for size in golden["sizes"]}


# --- which photographs


def test_without_the_shipped_folder_images_are_resized_to_its_size(copy: Copy) -> None:
    root = copy("mipnerf360/pebble")
    shipped = read_scene(root)
    shutil.rmtree(root / "images_4")
    scene = read_scene(root)
    assert (scene.image_folder, scene.resolution, scene.gt_resized) == ("images", 4, True)
    assert codes(scene) == ["SCENE_IMAGE_RESIZED"]
    assert sizes(scene) == sizes(shipped)
    np.testing.assert_allclose(scene.test[0].K, shipped.test[0].K, rtol=1e-12)


def test_folder_and_resolution_can_be_requested() -> None:
    root = STUBS / "mipnerf360/pebble"
    assert sizes(read_scene(root, image_folder="images_2")) == {(128, 96)}
    assert sizes(read_scene(root, image_folder="images", resolution=8)) == {(32, 24)}
    assert sizes(read_scene(root, image_folder="images", resolution=100)) == {(100, 75)}
    assert sizes(read_scene(STUBS / "dtu/scan1", resolution=1)) == {(144, 108)}
    assert not read_scene(STUBS / "dtu/scan1", resolution=1).gt_resized


def test_indoor_scenes_take_images_2(copy: Copy) -> None:
    scene = read_scene(copy("mipnerf360/pebble", "360_v2/bonsai"))
    assert (scene.dataset, scene.name, scene.image_folder) == ("mipnerf360", "bonsai", "images_2")
    assert scene.warnings == ()


def test_a_missing_training_photograph_is_a_warning(copy: Copy) -> None:
    root = copy("mipnerf360/pebble")
    (root / "images_4" / "DSC07951.JPG").unlink()
    scene = read_scene(root)
    assert codes(scene) == ["SCENE_IMAGE_MISSING"]
    assert "DSC07951.JPG" in scene.warnings[-1].message
    assert sizes(scene) == {(64, 48)}
    assert len(scene.train) == 14


def test_photographs_of_another_shape_than_the_camera_are_a_warning(copy: Copy) -> None:
    root = copy("tanksandtemples/pebble")
    shots = [f"{i} 1 0 0 0 0 0 4 1 {i:06d}.jpg\n\n" for i in range(1, 17)]
    text_model(root, "1 PINHOLE 223 120 300 300 111.5 60\n", "".join(shots))
    scene = read_scene(root)
    assert codes(scene) == ["SCENE_IMAGE"]
    assert scene.test[0].fov_y == pytest.approx(2 * np.arctan(120 / 600))


def test_a_custom_capture(copy: Copy) -> None:
    root = copy("mipnerf360/pebble", "mine/office")
    scene = read_scene(root)
    assert (scene.dataset, scene.name, scene.image_folder) == ("custom", "office", "images")
    assert scene.warnings == ()
    assert read_scene(root, dataset="offices").dataset == "offices"


def test_transforms_json_without_splits(copy: Copy) -> None:
    root = copy("nerf_synthetic/pebble", "mine/toy")
    (root / "transforms_train.json").rename(root / "transforms.json")
    (root / "transforms_test.json").unlink()
    scene = read_scene(root)
    assert (scene.layout, scene.image_folder, scene.mask_source) == ("transforms", ".", "png_alpha")
    names = sorted((f"train/r_{i}.png" for i in range(12)), key=lambda name: name.split("/")[1].split(".")[0])
    assert [camera.name for camera in scene.test] == names[::8]


# --- cameras


def test_conventions_differ_by_the_principal_point(copy: Copy) -> None:
    root = copy("mipnerf360/pebble")
    shots = [f"{i} 1 0 0 0 0 0 4 1 DSC{7949 + i:05d}.JPG\n\n" for i in range(1, 17)]
    text_model(root, "1 PINHOLE 256 192 270 271 140 90\n", "".join(shots))
    fov, full = read_scene(root, camera_convention="gs_fov"), read_scene(root)
    assert codes(fov) == ["SCENE_PRINCIPAL_POINT"]
    assert "3.0 pixels" in fov.warnings[-1].message
    assert codes(full) == []
    np.testing.assert_allclose(fov.test[0].K, [[67.5, 0, 32], [0, 67.75, 24], [0, 0, 1]])
    np.testing.assert_allclose(full.test[0].K, [[67.5, 0, 35], [0, 67.75, 22.5], [0, 0, 1]])
    assert full.test[0].source_size == (256, 192)


def test_diffsoup_uses_the_first_lens_for_all_views(copy: Copy) -> None:
    root = copy("mipnerf360/pebble")
    lenses = "7 PINHOLE 256 192 270 270 140 90\n1 PINHOLE 512 384 300 300 256 192\n"
    order = [16, *range(1, 16)]  # the last name first
    shots = [f"{i} 1 0 0 0 0 0 4 {7 if i == 16 else 1} DSC{7949 + i:05d}.JPG\n\n" for i in order]
    text_model(root, lenses, "".join(shots))
    scene = read_scene(root, rules="diffsoup")
    assert scene.camera_convention == "full_K"
    for camera in (*scene.train, *scene.test):
        np.testing.assert_allclose(camera.K, [[67.5, 0, 35], [0, 67.5, 22.5], [0, 0, 1]])
    ours = read_scene(root, camera_convention="full_K")
    assert {round(camera.fx, 3) for camera in ours.train} == {67.5, 37.5}


@pytest.mark.parametrize(
    ("rules", "place", "folder", "size", "background", "compositing"),
    [
        ("two_dts", "mipnerf360/pebble", "images", (64, 48), (1, 1, 1), "none"),
        ("two_dts", "tanksandtemples/pebble", "images", (112, 80), (0, 0, 0), "none"),
        ("two_dts", "nerf_synthetic/pebble", ".", (144, 144), (1, 1, 1), "after_resize"),
        ("mesh_splatting", "dtu/scan1", "images", (72, 54), (0, 0, 0), "none"),
        ("triangle_splatting", "nerf_synthetic/pebble", ".", (144, 144), (0, 0, 0), "before_resize"),
        ("diffsoup", "mipnerf360/pebble", "images_4", (64, 48), (0, 0, 0), "none"),
        ("diffsoup", "nerf_synthetic/pebble", ".", (144, 144), (1, 1, 1), "before_resize"),
    ],
)
def test_the_rules_of_the_methods(
    rules: str, place: str, folder: str, size: tuple[int, int], background: Any, compositing: str
) -> None:
    scene = read_scene(STUBS / place, rules=rules)
    assert scene.rules == rules
    assert scene.image_folder == folder
    assert sizes(scene) == {size}
    assert scene.background == background
    assert scene.compositing == compositing
    assert scene.quantized is (rules not in ("two_dts", "diffsoup"))


def test_the_background_can_be_passed() -> None:
    scene = read_scene(STUBS / "mipnerf360/pebble", background=(0, 0.5, 1))
    assert scene.background == (0, 0.5, 1)


# --- where scenes are


def test_scenes_are_found_below_a_folder() -> None:
    paths = [path.relative_to(STUBS).as_posix() for path in find_scenes(STUBS)]
    assert paths == sorted(SCENES)
    assert find_scenes(STUBS / "dtu") == [STUBS / "dtu/scan1"]
    assert find_scenes(STUBS / "dtu/scan1") == [STUBS / "dtu/scan1"]


def test_names_are_derived_from_a_relative_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(STUBS / "dtu" / "scan1")
    scene = read_scene(".")
    assert (scene.dataset, scene.name, scene.root) == ("dtu", "scan1", Path())


def test_the_garden_capture(shared: Path) -> None:
    scene = read_scene(shared / "golden/garden", image_folder="images_8")
    assert (scene.dataset, scene.name) == ("mipnerf360", "garden")
    assert (len(scene.train), len(scene.test)) == (28, 4)
    assert sizes(scene) == {(648, 420)}
    assert scene.test[0].source_size == (5187, 3361)
    assert scene.warnings == ()


ARGUMENTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "no rule": (DTU, {"rules": "two_dts"}, "SCENE_UNKNOWN"),
    "rules": (MIP, {"rules": "nerf"}, "SCENE_ARGUMENT"),
    "convention": (MIP, {"camera_convention": "K"}, "SCENE_ARGUMENT"),
    "resolution": (MIP, {"resolution": 0}, "SCENE_ARGUMENT"),
    "background": (MIP, {"background": (1, 2, 0)}, "SCENE_ARGUMENT"),
    "several": ("", {}, "SCENE_LAYOUT"),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_bad_arguments(name: str) -> None:
    place, options, code = ARGUMENTS[name]
    with pytest.raises(SceneError, match=code):
        read_scene(STUBS / place, **options)


def test_no_folder(tmp_path: Path) -> None:
    for find in (read_scene, find_scenes):
        with pytest.raises(InputError, match="FILE_NOT_FOUND"):
            find(tmp_path / "nowhere")
