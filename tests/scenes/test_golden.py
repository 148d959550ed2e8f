"""Real cameras: golden scenes of all methods, golden data of official loaders, and a real capture."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import Camera
from msb.scenes import read_points, sorted_by_stem, split_every_8th, stem
from tests.conftest import SHARED
from tests.golden.views import views

GOLDEN = SHARED / "golden"
METHODS = ("triangle_splatting", "mesh_splatting", "two_dts", "diffsoup")
SCENES = sorted(path.parent for method in METHODS for path in (GOLDEN / method).glob("*/views.npz"))


CHECKPOINTS = [scene for scene in SCENES if (scene / "checkpoint" / "cameras.json").exists()]


@pytest.mark.parametrize("scene", CHECKPOINTS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_cameras_of_a_checkpoint_equal_its_views(scene: Path) -> None:
    cameras = msb.read_cameras(scene / "checkpoint")
    golden = list(views(scene, scene.parent.name))
    assert len(cameras) >= len(golden)
    for view, camera in zip(golden, cameras, strict=False):
        wanted = msb.Camera(**view[1])
        resized = camera.resized(wanted.width, wanted.height)  # the file has the size of the photograph
        np.testing.assert_allclose(resized.K, wanted.K, rtol=1e-6)
        np.testing.assert_allclose(resized.world_to_camera, wanted.world_to_camera, atol=2e-6)


# --- three tiny scenes as read by the loaders of the 3DGS family


@pytest.fixture(scope="module")
def loaders(shared: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((shared / "golden/metrics/scenes/cameras.json").read_text())
    return data


def assert_is_loaded(camera: Camera, wanted: dict[str, Any], tolerance: dict[str, float]) -> None:
    """Compare a camera with the values of the 3DGS family: `R` (transposed), `T`, angles and centre."""
    assert stem(camera) == wanted["image_name"]
    assert abs(camera.fov_x - wanted["FoVx"]) < tolerance["fov_abs"]
    assert abs(camera.fov_y - wanted["FoVy"]) < tolerance["fov_abs"]
    np.testing.assert_allclose(camera.world_to_camera[:3, :3].T, wanted["R"], atol=1e-12)
    np.testing.assert_allclose(camera.world_to_camera[:3, 3], wanted["T"], atol=1e-12)
    atol = tolerance["float32_matrices_abs"]
    np.testing.assert_allclose(camera.world_to_camera.T, wanted["world_view_transform"], atol=atol)
    np.testing.assert_allclose(camera.center, wanted["camera_center"], atol=atol)
    # Their clip space: x / w is -1 at the left edge and 1 at the right.
    centered = camera.resized(wanted["width"], wanted["height"]).centered()
    ahead = centered.center + np.array([0.3, -0.2, 2]) @ centered.world_to_camera[:3, :3]
    clip = np.array([*ahead, 1]) @ np.array(wanted["full_proj_transform"])
    pixels, depth = centered.project(ahead)
    np.testing.assert_allclose(clip[3], depth, atol=1e-5)
    ndc = 2 * pixels / (wanted["width"], wanted["height"]) - 1
    np.testing.assert_allclose(clip[:2] / clip[3], ndc, atol=1e-5)


@pytest.mark.parametrize("scene", ["colmap_bin", "colmap_txt"])
def test_colmap_scenes_are_loaded_and_split_as_upstream(
    scene: str, shared: Path, loaders: dict[str, Any]
) -> None:
    folder = shared / "golden/metrics/scenes" / scene
    cameras = msb.read_cameras(folder)
    train, test = split_every_8th(cameras)
    radius, offset = nerf_normalization(train)
    compared = 0
    for golden in loaders[scene].values():
        if "train" not in golden:
            continue
        assert [stem(camera) for camera in train] == golden["train"]
        assert [stem(camera) for camera in test] == golden["test"]
        np.testing.assert_allclose(radius, golden["nerf_normalization_radius"], rtol=1e-6)
        np.testing.assert_allclose(offset, golden["nerf_normalization_translate"], atol=1e-6)
        for wanted in golden.get("cameras", []):
            same = [c for c in cameras if np.allclose(c.world_to_camera[:3, 3], wanted["T"], atol=1e-9)]
            assert len(same) == 1
            assert_is_loaded(same[0], wanted, loaders["tolerance"])
            compared += 1
    assert compared >= 4
    for camera in cameras:
        assert camera.image_path.is_file()
    assert len(read_points(folder)[0]) == loaders[scene]["points3D"]["count"]


def nerf_normalization(train: list[Camera]) -> tuple[float, np.ndarray]:
    """Return the scene scale that the 3DGS family derives from the centres of the training cameras."""
    centers = np.stack([camera.center for camera in train])
    middle = centers.mean(axis=0)
    return 1.1 * np.linalg.norm(centers - middle, axis=1).max(), -middle


def test_nerf_synthetic_scenes_are_loaded_as_upstream(shared: Path, loaders: dict[str, Any]) -> None:
    cameras = msb.read_cameras(shared / "golden/metrics/scenes/nerf_synthetic")
    assert [camera.split for camera in cameras] == ["train"] * 3 + ["test"] * 2
    for key in ("white", "black"):
        for wanted, camera in zip(loaders["nerf_synthetic"][key], cameras[3:], strict=True):
            assert (camera.width, camera.height) == (wanted["width"], wanted["height"])
            assert_is_loaded(camera, wanted, loaders["tolerance"])


# --- a real capture


def color_error(camera: Camera, photograph: np.ndarray, xyz: np.ndarray, rgb: np.ndarray) -> float:
    """Return the median difference between the colours of SfM points and their pixels in a photograph."""
    height, width = photograph.shape[:2]
    pixels, depth = camera.resized(width, height).project(xyz)
    inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)
    assert inside.sum() > 1000
    column, row = np.floor(pixels[inside]).astype(int).T
    return float(np.median(np.abs(photograph[row, column] - rgb[inside] / 255).mean(axis=1)))


@pytest.mark.slow
def test_points_of_the_garden_land_on_their_colours(shared: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    garden = shared / "golden" / "garden"
    cameras = sorted_by_stem(msb.read_cameras(garden))
    xyz, rgb = read_points(garden)
    assert (len(cameras), len(xyz)) == (32, 138_766)
    assert [len(part) for part in split_every_8th(cameras)] == [28, 4]
    errors = np.zeros((3, 8))
    for index, camera in enumerate(cameras[::4]):
        with image.open(garden / "images_8" / camera.name) as opened:
            photograph = np.asarray(opened.convert("RGB"), dtype=np.float64) / 255
        neighbour = cameras[4 * index + 1]
        shifted = replace(camera, cx=camera.cx + 400)  # of 5187 pixels
        for row, used in enumerate((camera, neighbour, shifted)):
            errors[row, index] = color_error(used, photograph, xyz[::8], rgb[::8])
    right, other, beside = errors  # measured values are 0.076 to 0.112, 0.142 to 0.241, and 0.132 to 0.182
    assert np.median(right) < 0.09
    assert right.max() < 0.12
    assert (other > right + 0.04).all()
    assert (beside > right + 0.03).all()
