"""Camera paths: turntables, flights, walks, and cameras in the gaps of a capture."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msb.base.matrices import inverse
from msb.errors import SceneError
from msb.scenes import Camera, interpolate_cameras, turntable
from msb.scenes.poses import look_at_pose
from msb.scenes.walk import PACE, fill_gaps, make_walk

from .builders import pose, some_cameras

TABLE = {"up": (0, 0, 1), "count": 12, "width": 64, "height": 48, "fov_y": 0.8}


def angle_between(a: Camera, b: Camera) -> float:
    turn = a.world_to_camera[:3, :3] @ b.world_to_camera[:3, :3].T
    return math.acos(min(1.0, (np.trace(turn) - 1) / 2))


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 2, -3), (1e-9, 1, 0)])
def test_a_turntable_looks_at_its_centre_from_everywhere(up: tuple[float, float, float]) -> None:
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


def test_a_turntable_with_z_up_starts_at_x() -> None:
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
def test_invalid_turntables_are_rejected(radius: float, change: dict[str, object], code: str) -> None:
    with pytest.raises(SceneError) as caught:
        turntable((0, 0, 0), radius, **(TABLE | change))
    assert caught.value.code == code


@pytest.mark.parametrize("closed", [False, True])
def test_a_flight_passes_through_the_given_cameras(closed: bool) -> None:
    cameras = some_cameras(5)
    count = 50 if closed else 41
    flight = interpolate_cameras(cameras, count, closed=closed)
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
    """With denser frames, the steps between frames change less. Therefore the velocity is continuous."""
    cameras = some_cameras(4)
    frames = interpolate_cameras(cameras, 1001, closed=closed)
    if closed:
        frames += frames[:2]
    centers = np.stack([frame.center for frame in frames])
    steps = np.diff(centers, axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < 0.02 * np.abs(steps).max()
    turns = np.array([angle_between(a, b) for a, b in itertools.pairwise(frames)])
    assert turns.max() < 0.02
    assert np.abs(np.diff(turns)).max() < 0.05 * turns.max()


def test_two_cameras_are_joined_by_a_line_and_the_shorter_rotation() -> None:
    first, last = some_cameras(2)
    flight = interpolate_cameras([first, last], 101)
    for part, camera in zip(np.linspace(0, 1, 101), flight, strict=True):
        np.testing.assert_allclose(camera.center, (1 - part) * first.center + part * last.center)
    whole = angle_between(first, last)
    angles = [angle_between(first, camera) for camera in flight]
    assert np.all(np.diff(angles) > 0)
    assert angles[50] == pytest.approx(whole / 2)  # slerp's middle
    total = sum(angle_between(a, b) for a, b in itertools.pairwise(flight))
    assert total == pytest.approx(whole, rel=1e-4)  # one axis throughout


def test_one_frame_is_the_first_camera() -> None:
    cameras = some_cameras(3)
    (only,) = interpolate_cameras(cameras, 1)
    np.testing.assert_allclose(only.world_to_camera, pose(0), atol=1e-12)


@pytest.mark.parametrize(("cameras", "count"), [(some_cameras(1), 5), ([], 5), (some_cameras(2), 0)])
def test_invalid_flights_are_rejected(cameras: list[Camera], count: int) -> None:
    with pytest.raises(SceneError) as caught:
        interpolate_cameras(cameras, count)
    assert caught.value.code == "CAMERA_PATH"


CAPTURE = turntable((1, 2, 3), 4, up=(0, 0, 1), count=12, width=80, height=60, fov_y=0.8)
STOPS = CAPTURE[::3]


def test_stops_are_displaced_and_keep_the_target_in_place() -> None:
    flight = make_walk(STOPS, CAPTURE, 4 * PACE, 0.25, 640)
    assert len(flight) == 4 * PACE
    sides = []
    for stop, camera in zip(flight[::PACE], STOPS, strict=True):
        offset = camera.world_to_camera[:3, :3] @ (stop.center - camera.center)
        np.testing.assert_allclose(np.linalg.norm(offset), 0.25 * 4)
        sides.append(np.round(offset, 6).tolist())
        np.testing.assert_allclose(stop.project((1, 2, 3))[0], camera.project((1, 2, 3))[0], atol=1e-6)
        assert (stop.width, stop.height) == (80, 60), "never larger than the photographs"
    assert sides == [[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1]]
    steps = np.linalg.norm(np.diff([camera.center for camera in [*flight, flight[0]]], axis=0), axis=1)
    assert steps.max() < 4 * np.median(steps), "no jumps, also on the way back to the start"


def test_a_longer_walk_begins_like_a_shorter_one_and_repeats() -> None:
    short, long = (make_walk(STOPS, CAPTURE, frames, 0.25, 40) for frames in (5, 5 * PACE))
    assert (short[0].width, short[0].height) == (40, 30)
    for number, camera in enumerate(short):
        for same in (long[number], long[4 * PACE + number]):
            np.testing.assert_array_equal(camera.world_to_camera, same.world_to_camera)


def test_outward_cameras_keep_their_directions() -> None:
    outward = [
        Camera(80, 60, 70, 70, 40, 30, np.diag([-1.0, 1, -1, 1]) @ camera.world_to_camera)
        for camera in CAPTURE
    ]
    (first, *_) = make_walk(outward[::3], outward, 3, 0.25, 80)
    np.testing.assert_allclose(first.world_to_camera[:3, :3], outward[0].world_to_camera[:3, :3], atol=1e-12)


def ring(count: int, middle: tuple[float, float, float] = (1, 2, 3)) -> list[Camera]:
    return turntable(middle, 4.0, up=(0, 0, 1), count=count, width=48, height=36, fov_y=0.6)


def looking(eye: tuple[float, ...], at: tuple[float, ...]) -> Camera:
    return Camera.from_fov(48, 36, look_at_pose(eye, at, (0, 0, 1)), fov_y=0.6)


def test_the_gaps_of_a_ring_are_closed_on_its_circle() -> None:
    added = fill_gaps(ring(8), 8)
    assert len(added) == 8
    every = np.stack([camera.center for camera in [*ring(8), *added]]) - (1, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(every, axis=1), 4)
    degrees = np.sort(np.degrees(np.arctan2(every[:, 1], every[:, 0])) % 360)
    np.testing.assert_allclose(np.diff(degrees), 22.5, atol=1e-9)
    for camera in added:
        pixel, depth = camera.project((1, 2, 3))
        np.testing.assert_allclose([*pixel, depth], (24, 18, 4), atol=1e-9)


def test_the_widest_gap_is_closed_first() -> None:
    cameras = [camera for number, camera in enumerate(ring(12)) if number not in (5, 6)]
    first, *_ = fill_gaps(cameras, 3)
    np.testing.assert_allclose(first.center, ring(24)[11].center, atol=1e-9)


def test_in_a_room_the_new_camera_is_on_a_straight_line() -> None:
    # The cameras stand back to back, so their common target is behind both.
    first, second = looking((1, 0, 0), (2, 0.5, 0)), looking((0, 1, 0), (0.5, 2, 0))
    (added,) = fill_gaps([first, second], 1)
    np.testing.assert_allclose(added.center, (0.5, 0.5, 0), atol=1e-12)
    np.testing.assert_allclose(added.world_to_camera[2, :3], np.array([1, 1, 0]) / np.sqrt(2), atol=1e-12)


def test_opposite_single_or_coincident_cameras_have_no_gap() -> None:
    here, there = looking((4, 0, 0), (0, 0, 0)), looking((-4, 0, 0), (0, 0, 0))
    assert fill_gaps([here, there], 9) == fill_gaps([here], 9) == fill_gaps([here] * 5, 9) == []
    assert fill_gaps(ring(5), 0) == fill_gaps(ring(5), -3) == []


def test_new_cameras_are_limited_named_and_without_photograph() -> None:
    near = [replace(looking((4, y, 0), (0, 0, 0)), image_path=Path(f"{y}.png")) for y in (-0.5, 0.5)]
    added = fill_gaps(near, 20)
    assert [camera.name for camera in added] == [f"between_{k:05d}" for k in range(20)]
    assert {camera.image_path for camera in added} == {None}
    assert len({camera.world_to_camera.tobytes() for camera in added}) == 20
    assert np.abs([camera.center[1] for camera in added]).max() < 0.5


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_gaps_do_not_depend_on_the_world_frame(turn: float) -> None:
    world = np.eye(4)
    world[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]] if turn else np.eye(3)
    world[:3, 3] = 7.0
    cameras = ring(7)
    moved = [
        Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera @ inverse(world)) for c in cameras
    ]
    for camera, other in zip(fill_gaps(cameras, 6), fill_gaps(moved, 6), strict=True):
        np.testing.assert_allclose(other.world_to_camera @ world, camera.world_to_camera, atol=1e-9)


def test_half_a_turn_between_neighbours_is_interpolated() -> None:
    back = np.diag([-1.0, 1, -1, 1])
    cameras = [Camera(4, 4, 1, 1, 2, 2, matrix) for matrix in (np.eye(4), back, np.eye(4))]
    for camera in interpolate_cameras(cameras, 21) + interpolate_cameras(cameras, 21, closed=True):
        assert np.isfinite(camera.world_to_camera).all()
