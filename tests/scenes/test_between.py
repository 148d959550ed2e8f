"""Cameras between those of a capture: they close the widest gaps, and look at what all look at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msb.base.matrices import inverse
from msb.scenes import Camera
from msb.scenes.paths import turntable
from msb.scenes.poses import look_at_pose
from msb.scenes.walk import between


def ring(count: int, middle: tuple[float, float, float] = (1, 2, 3)) -> list[Camera]:
    return turntable(middle, 4.0, up=(0, 0, 1), count=count, width=48, height=36, fov_y=0.6)


def looking(eye: tuple[float, ...], at: tuple[float, ...]) -> Camera:
    return Camera.from_fov(48, 36, look_at_pose(eye, at, (0, 0, 1)), fov_y=0.6)


def test_the_gaps_of_a_ring_are_closed_on_its_circle() -> None:
    made = between(ring(8), 8)
    assert len(made) == 8
    every = np.stack([camera.center for camera in [*ring(8), *made]]) - (1, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(every, axis=1), 4)
    degrees = np.sort(np.degrees(np.arctan2(every[:, 1], every[:, 0])) % 360)
    np.testing.assert_allclose(np.diff(degrees), 22.5, atol=1e-9)
    for camera in made:
        pixel, depth = camera.project((1, 2, 3))
        np.testing.assert_allclose([*pixel, depth], (24, 18, 4), atol=1e-9)


def test_the_widest_gap_is_closed_first() -> None:
    cameras = [camera for number, camera in enumerate(ring(12)) if number not in (5, 6)]
    first, *_ = between(cameras, 3)
    np.testing.assert_allclose(first.center, ring(24)[11].center, atol=1e-9)


def test_in_a_room_it_goes_straight() -> None:
    # Back to back, what they look away from is behind both.
    one, other = looking((1, 0, 0), (2, 0.5, 0)), looking((0, 1, 0), (0.5, 2, 0))
    (made,) = between([one, other], 1)
    np.testing.assert_allclose(made.center, (0.5, 0.5, 0), atol=1e-12)
    np.testing.assert_allclose(made.world_to_camera[2, :3], np.array([1, 1, 0]) / np.sqrt(2), atol=1e-12)


def test_who_stands_opposite_alone_or_together_has_nobody_between() -> None:
    here, there = looking((4, 0, 0), (0, 0, 0)), looking((-4, 0, 0), (0, 0, 0))
    assert between([here, there], 9) == between([here], 9) == between([here] * 5, 9) == []
    assert between(ring(5), 0) == between(ring(5), -3) == []


def test_there_are_no_more_than_asked_for_and_each_has_its_name_and_no_photograph() -> None:
    near = [replace(looking((4, y, 0), (0, 0, 0)), image_path=Path(f"{y}.png")) for y in (-0.5, 0.5)]
    made = between(near, 20)
    assert [camera.name for camera in made] == [f"between_{k:05d}" for k in range(20)]
    assert {camera.image_path for camera in made} == {None}
    assert len({camera.world_to_camera.tobytes() for camera in made}) == 20
    assert np.abs([camera.center[1] for camera in made]).max() < 0.5


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_it_does_not_matter_how_the_world_lies(turn: float) -> None:
    world = np.eye(4)
    world[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]] if turn else np.eye(3)
    world[:3, 3] = 7.0
    cameras = ring(7)
    moved = [
        Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera @ inverse(world)) for c in cameras
    ]
    for one, other in zip(between(cameras, 6), between(moved, 6), strict=True):
        np.testing.assert_allclose(other.world_to_camera @ world, one.world_to_camera, atol=1e-9)
