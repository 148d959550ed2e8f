"""A walk off the path of a capture."""

from __future__ import annotations

import numpy as np

from msb.scenes import turntable
from msb.scenes.walk import PACE, walk

CAPTURE = turntable((1, 2, 3), 4, up=(0, 0, 1), count=12, width=80, height=60, fov_y=0.8)
STOPS = CAPTURE[::3]


def test_stops_lie_off_the_cameras_and_keep_what_they_look_at_in_place() -> None:
    flight = walk(STOPS, CAPTURE, 4 * PACE, 0.25, 640)
    assert len(flight) == 4 * PACE
    sides = []
    for stop, camera in zip(flight[::PACE], STOPS, strict=True):
        offset = camera.world_to_camera[:3, :3] @ (stop.center - camera.center)
        np.testing.assert_allclose(np.linalg.norm(offset), 0.25 * 4)
        sides.append(np.round(offset, 6).tolist())
        np.testing.assert_allclose(stop.project((1, 2, 3))[0], camera.project((1, 2, 3))[0], atol=1e-6)
        assert (stop.width, stop.height) == (80, 60), "never larger than the photographs"
    assert sides == [[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1]]
    steps = np.linalg.norm(np.diff([one.center for one in [*flight, flight[0]]], axis=0), axis=1)
    assert steps.max() < 4 * np.median(steps), "it has no jump, the way back to the start included"


def test_a_longer_walk_begins_like_a_shorter_one_and_goes_round_again() -> None:
    short, long = (walk(STOPS, CAPTURE, frames, 0.25, 40) for frames in (5, 5 * PACE))
    assert (short[0].width, short[0].height) == (40, 30)
    for number, camera in enumerate(short):
        for same in (long[number], long[4 * PACE + number]):
            np.testing.assert_array_equal(camera.world_to_camera, same.world_to_camera)


def test_cameras_that_look_apart_keep_their_directions() -> None:
    outward = [
        one.__class__(80, 60, 70, 70, 40, 30, np.diag([-1.0, 1, -1, 1]) @ one.world_to_camera)
        for one in CAPTURE
    ]
    (first, *_) = walk(outward[::3], outward, 3, 0.25, 80)
    np.testing.assert_allclose(first.world_to_camera[:3, :3], outward[0].world_to_camera[:3, :3], atol=1e-12)
