"""Flicker and holes of synthetic frames with known results."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.metrics.steadiness import (
    PreparedFrame,
    find_holes,
    find_surface_points,
    prepare_frame,
    unexplained_change,
)
from msb.scenes import Camera

WIDTH, HEIGHT = 96, 72
# Camera positions in three frames; at the depth of the far board a pixel is about 0.05.
PLACES = (0.0, 0.05, 0.1)


def camera(place: float) -> Camera:
    return Camera.look_at(
        (place, -0.3 * place, 0), (0, 0, 4), up=(0.3, -1, 0), width=WIDTH, height=HEIGHT, fov_y=0.9
    )


def boards(at: Camera, samples: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return image, alpha and depth of a small board in front of a large board; pixels have `samples`^2
    samples.
    """
    big = at.resized(WIDTH * samples, HEIGHT * samples)
    y, x = np.mgrid[: big.height, : big.width] + 0.5
    rays = np.stack([(x - big.cx) / big.fx, (y - big.cy) / big.fy, np.ones_like(x)], axis=-1)
    world = rays @ big.camera_to_world[:3, :3].T
    image, alpha, depth = np.ones((*x.shape, 3)), np.zeros_like(x), np.full_like(x, np.inf)
    for place, half, pitch in ((4.0, 1.7, 9.0), (3.0, 0.5, 15.0)):
        length = (place - big.center[2]) / world[..., 2]
        u, v = np.moveaxis(world[..., :2] * length[..., None] + big.center[:2], -1, 0)
        hit = (np.abs(u) < half) & (np.abs(v) < half)
        color = np.stack([0.5 + 0.4 * np.sin(pitch * u), 0.5 + 0.4 * np.sin(pitch * v), u > v], axis=-1)
        image[hit], alpha[hit], depth[hit] = color[hit], 1, length[hit]

    def blocks(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values.reshape(HEIGHT, samples, WIDTH, samples, *values.shape[2:])

    nearest = blocks(depth).min(axis=(1, 3))
    means = (blocks(values).mean(axis=(1, 3)).astype(np.float32) for values in (image, alpha))
    return *means, np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def changed(
    samples: int, edit: Callable[[int, NDArray[np.float32]], object] = lambda *_: None
) -> NDArray[np.float32]:
    stills = []
    for number, place in enumerate(PLACES):
        image, alpha, depth = boards(camera(place), samples)
        edit(number, image)
        stills.append(prepare_frame(camera(place), image, alpha, depth))
    return unexplained_change(*stills)


def rms(change: NDArray[np.float32]) -> float:
    assert np.isfinite(change).mean() > 0.3
    return float(np.sqrt(np.nanmean(np.square(change))))


@pytest.mark.slow
def test_motion_and_steady_change_are_not_flicker() -> None:
    assert rms(changed(8)) < 0.15
    brighter = changed(8, lambda number, image: np.multiply(image, 0.8 + 0.02 * number, out=image))
    assert rms(brighter) < 0.15


@pytest.mark.slow
def test_fewer_samples_flicker_more() -> None:
    single, sixteen, sixtyfour = (rms(changed(samples)) for samples in (1, 4, 8))
    assert single > 4 * sixteen > 5 * sixtyfour


def test_change_in_one_frame_flickers_by_the_same_amount() -> None:
    def pop(number: int, image: NDArray[np.float32]) -> None:
        if number == 1:
            image[26:46, 20:32] += np.float32(20 / 255)

    change = changed(8, pop)
    np.testing.assert_allclose(change[32:40, 25:27], 20, atol=0.5)
    assert np.nanmax(np.delete(change, slice(20, 52), axis=0)) < 5


def test_hidden_or_outside_pixels_do_not_count() -> None:
    (_, before), (_, here), (_, after) = (
        (p, prepare_frame(camera(p), *boards(camera(p), 2))) for p in (0.0, 0.5, 1.0)
    )
    change = unexplained_change(before, here, after)
    border = np.isnan(change) & here.covered
    assert border.any()
    assert not border.all()
    assert np.isnan(change[:, :3]).all()


def seen(place: float, *cut: tuple[slice, slice]) -> PreparedFrame:
    image, alpha, depth = boards(camera(place), 2)
    for part in cut:
        alpha[part] = 0
    return prepare_frame(camera(place), image, alpha, depth)


def test_holes_are_gaps_and_specks() -> None:
    whole = [seen(place) for place in PLACES]
    points = np.concatenate([find_surface_points(frame) for frame in whole])
    for frame in whole:
        assert not find_holes(frame, points).any(), "a complete model has no holes, including its borders"
    large, speck = (slice(30, 42), slice(20, 31)), (slice(56, 59), slice(50, 52))
    result = find_holes(seen(PLACES[1], large, speck), points)
    assert result[speck].all()
    inner = np.zeros_like(result)
    inner[31:41, 21:30] = True
    assert result[inner].all()
    result[large] = result[speck] = False
    assert not result.any()
    assert not find_holes(seen(PLACES[1], large), points[:0]).any(), (
        "without surface points of other frames a large gap is not a hole"
    )


@pytest.mark.parametrize("behind", [True, False])
def test_model_outside_the_image_has_no_flicker_and_no_holes(behind: bool) -> None:
    frames = [
        Camera.look_at((0, 0, 9 if behind else 0), (place, 0, 20), width=32, height=24, fov_y=0.9)
        for place in PLACES
    ]
    empty = [
        prepare_frame(view, np.ones((24, 32, 3), np.float32), *np.zeros((2, 24, 32), np.float32))
        for view in frames
    ]
    assert np.isnan(unexplained_change(*empty)).all()
    for before, here in pairwise(empty):
        assert not find_holes(here, np.array([[0.0, 0, 4]]) if behind else find_surface_points(before)).any()
