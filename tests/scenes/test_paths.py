"""Camera paths: turntables and flights."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from msb.errors import SceneError
from msb.scenes import Camera, interpolated, turntable

from .builders import pose, some_cameras

TABLE = {"up": (0, 0, 1), "count": 12, "width": 64, "height": 48, "fov_y": 0.8}


def angle_between(a: Camera, b: Camera) -> float:
    turn = a.world_to_camera[:3, :3] @ b.world_to_camera[:3, :3].T
    return math.acos(min(1.0, (np.trace(turn) - 1) / 2))


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 2, -3), (1e-9, 1, 0)])
def test_a_turntable_looks_at_its_middle_from_everywhere(up: tuple[float, float, float]) -> None:
    middle = np.array([3.0, -1, 2])
    cameras = turntable(middle, 5, **(TABLE | {"up": up}), elevation=0.4)
    assert [camera.name for camera in cameras[:2]] == ["turntable_00000", "turntable_00001"]
    axis = np.array(up) / np.linalg.norm(up)
    for before, camera in zip([cameras[-1], *cameras[:-1]], cameras, strict=True):
        pixels, depth = camera.project([middle, middle + 0.1 * axis])
        np.testing.assert_allclose(pixels[0], [32, 24], atol=1e-9)
        np.testing.assert_allclose(pixels[1, 0], 32, atol=1e-9)
        assert pixels[1, 1] < 24  # up is up
        assert depth[0] == pytest.approx(5)
        assert (camera.center - middle) @ axis == pytest.approx(5 * math.sin(0.4))
        # Counter-clockwise seen from above, by the same angle.
        turn = np.cross(before.center - middle, camera.center - middle) @ axis
        assert turn == pytest.approx((5 * math.cos(0.4)) ** 2 * math.sin(2 * math.pi / 12))


def test_a_turntable_starts_at_x_where_z_is_up() -> None:
    first, second, *_ = turntable((0, 0, 0), 2, **(TABLE | {"count": 4}))
    np.testing.assert_allclose(first.center, [2, 0, 0], atol=1e-15)
    np.testing.assert_allclose(second.center, [0, 2, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("radius", "change", "code"),
    [
        (0, {}, "CAMERA_PATH"),
        (1, {"count": 0}, "CAMERA_PATH"),
        (1, {"count": 10**9}, "CAMERA_PATH"),
        (1, {"elevation": math.pi / 2}, "CAMERA_PATH"),
        (1, {"up": (0, 0, 0)}, "CAMERA_PATH"),
        (1, {"width": 0}, "CAMERA_INVALID"),
    ],
)
def test_a_turntable_that_cannot_be_is_refused(radius: float, change: dict[str, object], code: str) -> None:
    with pytest.raises(SceneError) as caught:
        turntable((0, 0, 0), radius, **(TABLE | change))
    assert caught.value.code == code


@pytest.mark.parametrize("closed", [False, True])
def test_a_flight_passes_through_the_given_cameras(closed: bool) -> None:
    cameras = some_cameras(5)
    count = 50 if closed else 41
    flight = interpolated(cameras, count, closed=closed)
    assert len(flight) == count
    assert flight[3].name == "flight_00003"
    for camera, met in zip(cameras, flight[::10], strict=True):
        wanted = camera.resized(cameras[0].width, cameras[0].height)
        np.testing.assert_allclose(met.world_to_camera, wanted.world_to_camera, atol=1e-9)
        np.testing.assert_allclose(met.K, wanted.K)
        assert (met.width, met.height) == (cameras[0].width, cameras[0].height)


@pytest.mark.slow
@pytest.mark.parametrize("closed", [False, True])
def test_a_flight_has_no_kinks(closed: bool) -> None:
    """Steps between frames change by less and less as the frames get denser: the velocity is continuous."""
    cameras = some_cameras(4)
    frames = interpolated(cameras, 1001, closed=closed)
    if closed:
        frames += frames[:2]
    centers = np.stack([frame.center for frame in frames])
    steps = np.diff(centers, axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < 0.02 * np.abs(steps).max()
    turns = np.array([angle_between(a, b) for a, b in itertools.pairwise(frames)])
    assert turns.max() < 0.02
    assert np.abs(np.diff(turns)).max() < 0.05 * turns.max()


def test_two_cameras_are_joined_by_a_line_and_the_shorter_turn() -> None:
    first, last = some_cameras(2)
    flight = interpolated([first, last], 101)
    for part, camera in zip(np.linspace(0, 1, 101), flight, strict=True):
        np.testing.assert_allclose(camera.center, (1 - part) * first.center + part * last.center)
    whole = angle_between(first, last)
    angles = [angle_between(first, camera) for camera in flight]
    assert np.all(np.diff(angles) > 0)
    assert angles[50] == pytest.approx(whole / 2)  # slerp's middle
    total = sum(angle_between(a, b) for a, b in itertools.pairwise(flight))
    assert total == pytest.approx(whole, rel=1e-4)  # one axis throughout


def test_half_a_turn_between_neighbours_is_flown_too() -> None:
    back = np.diag([-1.0, 1, -1, 1])
    cameras = [Camera(4, 4, 1, 1, 2, 2, matrix) for matrix in (np.eye(4), back, np.eye(4))]
    for camera in interpolated(cameras, 21) + interpolated(cameras, 21, closed=True):
        assert np.isfinite(camera.world_to_camera).all()


def test_one_frame_is_the_first_camera() -> None:
    cameras = some_cameras(3)
    (only,) = interpolated(cameras, 1)
    np.testing.assert_allclose(only.world_to_camera, pose(0), atol=1e-12)


@pytest.mark.parametrize(("cameras", "count"), [(some_cameras(1), 5), ([], 5), (some_cameras(2), 0)])
def test_a_flight_that_cannot_be_is_refused(cameras: list[Camera], count: int) -> None:
    with pytest.raises(SceneError) as caught:
        interpolated(cameras, count)
    assert caught.value.code == "CAMERA_PATH"
