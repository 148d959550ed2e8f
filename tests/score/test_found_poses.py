"""Poses found from photographs: disturbed copies, tricks and wrong captures."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import msb
from data_stubs.still_life import pebbles
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.score import score as measure
from msb.score.capture import Capture
from msb.score.features import detect_features
from msb.score.pose import Photograph, PoseNotFoundError, find_pose
from tests.conftest import ROOT
from tests.score import tricks

pytest.importorskip("cv2")
pytestmark = pytest.mark.slow
SCENES = ROOT / "data_stubs" / "scenes"
SOUP = ROOT / "data_stubs" / "models" / "pebble" / "two_dts"
MOST_PIXELS = 0.5


@cache
def read(name: str) -> Capture:
    return Capture(SCENES / name)


@cache
def still_life() -> Mesh:
    """Return the pebbles, whose table is symmetric while its stones are not."""
    surface = pebbles()
    return Mesh(surface.vertices, surface.faces, (np.clip(surface.color, 0, 1) * 255 + 0.5).astype(np.uint8))


def measure_error(mesh: Mesh, disturbed: Mesh, matrix: np.ndarray, capture: Capture) -> float:
    """Return the median distance in pixels of points of the asset over the held-out views."""
    rows = np.random.default_rng(0).choice(np.unique(mesh.faces), 500)
    back = disturbed.vertices[rows] @ matrix[:3, :3].T + matrix[:3, 3]
    errors = [
        np.linalg.norm(camera.project(mesh.vertices[rows])[0] - camera.project(back)[0], axis=1)
        for camera in capture.scene.test
    ]
    return float(np.nanmedian(np.concatenate(errors)))


@pytest.mark.parametrize(("name", "number"), [("mesh", 0), ("mesh", 3), ("soup", 1)])
def test_the_pose_of_a_disturbed_copy_is_found(name: str, number: int) -> None:
    capture = read("nerf_synthetic/pebble")
    mesh = still_life() if name == "mesh" else mesh_from_asset(msb.open(SOUP))
    disturbed, matrix = tricks.disturb(mesh, number)
    pose = find_pose(disturbed, capture.photographs())
    assert measure_error(mesh, disturbed, pose.matrix, capture) < MOST_PIXELS
    assert pose.mirrored == (np.linalg.det(matrix) < 0)
    assert pose.photographs >= 20
    assert pose.residual is not None
    assert pose.residual < 1
    assert np.isclose(pose.scale * np.cbrt(abs(np.linalg.det(matrix))), 1, atol=0.005)


def test_a_wrong_capture_is_not_found() -> None:
    with pytest.raises(PoseNotFoundError):
        find_pose(still_life(), Capture(ROOT / "tests" / "tiny" / "scenes" / "dtu" / "scan1").photographs())
    surface = tricks.noise()
    with pytest.raises(PoseNotFoundError):
        find_pose(surface, read("nerf_synthetic/pebble").photographs())


@pytest.mark.parametrize(
    ("trick", "pose"),
    [
        ("photograph_on_a_card", "found"),
        ("photograph_on_a_card", "capture"),
        ("sequence_of_planes", "capture"),
        ("dome", "capture"),
        ("billboards", "found"),
    ],
)
def test_tricks_are_unverified_or_named(trick: str, pose: str, tmp_path: Path) -> None:
    capture = read("nerf_synthetic/pebble")
    mesh = getattr(tricks, trick)(capture.scene)
    path = tmp_path / ("asset.obj" if mesh.textures else "asset.ply")
    msb.save(asset_from_mesh(mesh), path)
    result = measure(path, capture, pose=pose)
    codes = {flag.code for flag in result.flags}
    assert result.status == "unverified" or codes & {"NO_PARALLAX", "SINGLE_VIEW_FACES"}


def test_the_pose_of_a_room_is_found_from_inside() -> None:
    """From outside, the walls show their backs, which are mirror images."""
    mesh, cameras = tricks.room(), tricks.cameras_in_the_room(24)
    with msb.Renderer(asset_from_mesh(mesh), tier="standard", supersample=3) as renderer:
        images = [renderer.render(camera).image for camera in cameras]
    photographs = [
        Photograph(camera, detect_features(image, 2000))
        for camera, image in zip(cameras, images, strict=True)
    ]
    disturbed, matrix = tricks.disturb(mesh, 2)
    pose = find_pose(disturbed, photographs)
    assert pose.mirrored == (np.linalg.det(matrix) < 0)
    assert pose.photographs == len(cameras)
    assert np.abs(pose.matrix @ matrix - np.eye(4)).max() < 2e-3


def test_a_given_pose_that_is_wrong_is_named(tmp_path: Path) -> None:
    mesh = still_life()
    path = tmp_path / "asset.ply"
    msb.save(asset_from_mesh(replace(mesh, vertices=mesh.vertices @ tricks.QUARTER)), path)
    result = measure(path, read("nerf_synthetic/pebble"), pose="capture")
    assert "MISALIGNED" in {flag.code for flag in result.flags}


def test_a_mirrored_copy_scores_like_the_asset(tmp_path: Path) -> None:
    capture = read("nerf_synthetic/pebble")
    mesh = mesh_from_asset(msb.open(SOUP))
    results = {}
    for name, vertices in (("as_is", mesh.vertices), ("mirrored", 1e5 * mesh.vertices * (-1, 1, 1))):
        path = tmp_path / f"{name}.ply"
        msb.save(asset_from_mesh(replace(mesh, vertices=vertices)), path)
        results[name] = measure(path, capture)
    assert not results["as_is"].flags
    assert {flag.code for flag in results["mirrored"].flags} >= {"MIRRORED", "EXTREME_SCALE"}
    first, second = (result.looks["psnr"] for result in results.values() if result.looks is not None)
    assert first == pytest.approx(second, abs=0.05)
