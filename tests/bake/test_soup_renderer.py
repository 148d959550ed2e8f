"""Sums over the images of a soup on the device, against NumPy and against finite differences."""

import numpy as np
import pytest

from msb.bake.soup_renderer import SoupRenderer
from msb.cl import Device
from tests.bake.soups import ColoredSoup, cameras, open_renderer, tiles
from tests.bake.sums_twin import Drawn, changes_of, sums_of


def draw(renderer: SoupRenderer, number: int) -> Drawn:
    frame = renderer.render(renderer.images.cameras[number], renderer.images.background)
    return Drawn(frame.image.astype(float), frame.depth.astype(float), frame.face_id)


def scattered(seed: int, count: int = 40) -> ColoredSoup:
    random = np.random.default_rng(seed)
    corners = random.normal(size=(count, 1, 3)) * 0.7 + random.normal(size=(count, 3, 3)) * 0.5
    return corners.astype(np.float32), random.uniform(size=(count, 3, 3)).astype(np.float32)


def test_sums_agree_with_numpy(device: Device) -> None:
    corners, colors = scattered(1)
    with open_renderer((corners, colors), scattered(2), cameras(2), device) as renderer:
        sums = renderer.sum_faces([0, 1])
        twins = [
            sums_of(corners, camera, draw(renderer, k), renderer.images.image(k).astype(float))
            for k, camera in enumerate(renderer.images.cameras)
        ]
    upper = np.triu_indices(3)
    products, targets, gradients = (sum(twin[k] for twin in twins) for k in range(3))
    np.testing.assert_allclose(sums.sums[:, :6], products[:, upper[0], upper[1]], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(sums.sums[:, 6:], targets.reshape(-1, 9), rtol=1e-4, atol=1e-3)
    scale = np.abs(gradients).max()
    np.testing.assert_allclose(sums.gradients / scale, gradients / scale, atol=1e-4)
    np.testing.assert_array_equal(sums.max_pixels, np.maximum(twins[0].pixels, twins[1].pixels))


def test_changes_agree_with_numpy(device: Device) -> None:
    corners, colors = scattered(3)
    owner = np.full(len(corners), -1, np.int32)
    owner[::4] = np.arange(len(owner[::4]))
    proposals = int(owner.max()) + 1
    selected = np.ones(len(corners), bool)
    with open_renderer((corners, colors), scattered(4), cameras(2), device) as renderer:
        before = [draw(renderer, k) for k in (0, 1)]
        renderer.remember([0, 1])
        selected[::4] = False
        renderer.update(corners + np.float32(0.05) * selected[:, None, None], colors, selected)
        changes = renderer.measure_changes(owner, proposals)
        after = [draw(renderer, k) for k in (0, 1)]
        targets = [renderer.images.image(k).astype(float) for k in (0, 1)]
    twins = [changes_of(before[k], after[k], targets[k], owner, proposals) for k in (0, 1)]
    np.testing.assert_allclose(changes, twins, atol=2e-2 if not device.record.int64_atomics else 1e-3)


def test_two_runs_have_the_same_bits(device: Device) -> None:
    runs = []
    for _ in range(2):
        with open_renderer(scattered(5), scattered(6), cameras(3), device) as renderer:
            runs.append(renderer.sum_faces(range(3)))
    for first, second in zip(*runs, strict=True):
        assert first.tobytes() == second.tobytes()


def test_gradients_agree_with_finite_differences(device: Device) -> None:
    """The target image shows the same bright face, enlarged, on a dark background."""
    corners = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32)
    colors = np.full((1, 3, 3), 0.8, np.float32)
    larger = corners * np.float32(1.2)
    with open_renderer((corners, colors), (larger, colors), cameras(1, 200, 150), device) as renderer:
        gradients = renderer.sum_faces([0]).gradients
        step = np.float32(0.03)

        def error(moved: np.ndarray) -> float:
            renderer.update(moved, colors, np.ones(1, bool))
            return float(np.square(draw(renderer, 0).image - renderer.images.image(0)).sum())

        for axis in (0, 1):
            for corner in range(3):
                shift = np.zeros_like(corners)
                shift[0, corner, axis] = step
                difference = (error(corners + shift) - error(corners - shift)) / (2 * step)
                assert gradients[0, corner, axis] == pytest.approx(difference, rel=0.25, abs=30)
        assert gradients[0, 2, 1] < 0 < gradients[0, 0, 0]  # both corners should move outwards


def test_hidden_faces_cover_no_pixel(device: Device) -> None:
    corners, colors = tiles()
    selected = np.arange(len(corners)) % 2 == 0
    with open_renderer((corners, colors), (corners, colors), cameras(1), device) as renderer:
        assert renderer.measure_error() < 1e-6
        renderer.update(corners, colors, selected)
        pixels = renderer.sum_faces([0]).max_pixels
    assert (pixels[selected] > 0).all()
    assert (pixels[~selected] == 0).all()
