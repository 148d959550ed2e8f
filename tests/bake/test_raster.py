"""What the device sums over pictures of a soup, against NumPy and against what it must come to."""

import numpy as np
import pytest

from msb.bake.raster import Raster
from msb.cl import Device
from tests.bake.soups import cameras, taught, tiles
from tests.bake.teaching_twin import Drawn, booked, sums_of


def drawn(raster: Raster, number: int) -> Drawn:
    frame = raster.render(raster.lessons.cameras[number], raster.lessons.background)
    return Drawn(frame.image.astype(float), frame.depth.astype(float), frame.face_id)


def scattered(seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    corners = random.normal(size=(count, 1, 3)) * 0.7 + random.normal(size=(count, 3, 3)) * 0.5
    return corners.astype(np.float32), random.uniform(size=(count, 3, 3)).astype(np.float32)


def test_sums_are_those_of_numpy(device: Device) -> None:
    corners, colors = scattered(1)
    with taught((corners, colors), scattered(2), cameras(2), device) as raster:
        seen = raster.seen([0, 1])
        twins = [
            sums_of(corners, camera, drawn(raster, k), raster.lessons.image(k).astype(float))
            for k, camera in enumerate(raster.lessons.cameras)
        ]
    upper = np.triu_indices(3)
    products, sides, slopes = (sum(each[k] for each in twins) for k in range(3))
    np.testing.assert_allclose(seen.sums[:, :6], products[:, upper[0], upper[1]], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(seen.sums[:, 6:], sides.reshape(-1, 9), rtol=1e-4, atol=1e-3)
    scale = np.abs(slopes).max()
    np.testing.assert_allclose(seen.slopes / scale, slopes / scale, atol=1e-4)
    np.testing.assert_array_equal(seen.most, np.maximum(twins[0].pixels, twins[1].pixels))


def test_changes_are_booked_as_numpy_books_them(device: Device) -> None:
    corners, colors = scattered(3)
    owner = np.full(len(corners), -1, np.int32)
    owner[::4] = np.arange(len(owner[::4]))
    keep = np.ones(len(corners), bool)
    with taught((corners, colors), scattered(4), cameras(2), device) as raster:
        before = [drawn(raster, k) for k in (0, 1)]
        raster.remember([0, 1])
        keep[::4] = False
        raster.change(corners + np.float32(0.05) * keep[:, None, None], colors, keep)
        found = raster.judge(owner, int(owner.max()) + 1)
        after = [drawn(raster, k) for k in (0, 1)]
        twins = [
            booked(before[k], after[k], raster.lessons.image(k).astype(float), owner, int(owner.max()) + 1)
            for k in (0, 1)
        ]
    np.testing.assert_allclose(found, twins, atol=2e-2 if not device.record.int64_atomics else 1e-3)


def test_two_runs_have_the_same_bits(device: Device) -> None:
    corners, colors = scattered(5)
    found = []
    for _ in range(2):
        with taught((corners, colors), scattered(6), cameras(3), device) as one:
            found.append(one.seen(range(3)))
    for first, second in zip(*found, strict=True):
        assert first.tobytes() == second.tobytes()


def test_slopes_say_how_the_error_changes(device: Device) -> None:
    """One bright face before a dark background: the error of drawing it larger is that of its border."""
    corners = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32)
    colors = np.full((1, 3, 3), 0.8, np.float32)
    camera = cameras(1, 200, 150)
    larger = corners * np.float32(1.2)
    with taught((corners, colors), (larger, colors), camera, device) as raster:
        rises = raster.seen([0]).slopes
        step = np.float32(0.03)

        def error(moved: np.ndarray) -> float:
            raster.change(moved, colors, np.ones(1, bool))
            return float(np.square(drawn(raster, 0).image - raster.lessons.image(0)).sum())

        for axis in (0, 1):
            for corner in range(3):
                shift = np.zeros_like(corners)
                shift[0, corner, axis] = step
                measured = (error(corners + shift) - error(corners - shift)) / (2 * step)
                assert rises[0, corner, axis] == pytest.approx(measured, rel=0.25, abs=30)
        assert rises[0, 2, 1] < 0 < rises[0, 0, 0]  # both ends want to move outward


def test_a_face_that_is_not_kept_shows_no_pixel(device: Device) -> None:
    corners, colors = tiles()
    keep = np.arange(len(corners)) % 2 == 0
    with taught((corners, colors), (corners, colors), cameras(1), device) as raster:
        assert raster.error() < 1e-6
        raster.change(corners, colors, keep)
        most = raster.seen([0]).most
    assert (most[keep] > 0).all()
    assert (most[~keep] == 0).all()
