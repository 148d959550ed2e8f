"""DiffSoup's kernels on random scenes against the NumPy reference, and limit cases."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset
from msb.cl import Device
from msb.methods.diffsoup.native import Pipeline as DiffSoupPipeline
from msb.reference import render_reference
from msb.render import Frame
from msb.scenes import Camera
from tests.cl.conftest import STYLES, open_styled
from tests.reference.soups import lattice_model
from tests.render.frames import frame_of

BLACK = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module", params=STYLES)
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    with open_styled(request.param) as opened:
        yield opened


def soup(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles of all sizes in front of, across and behind the camera, with shared vertices.

    Some triangles are duplicated, with the same or a rotated vertex order. Some triangles are stacked more
    closely than the depth key can resolve. Some triangles are slivers, and some have no area.
    """
    rng = np.random.default_rng(seed)
    center = rng.normal(0, 1, (150, 1, 3)) * (1.5, 1.2, 3) + (0, 0, 4)
    size = np.exp(rng.normal(-1, 1.2, (150, 1, 1)))
    triangles = center + size * rng.normal(0, 1, (150, 3, 3))
    triangles[:8] = rng.normal(0, 6, (8, 3, 3))
    triangles[8:16, 2] = triangles[8:16, 1] + 1e-4 * rng.normal(0, 1, (8, 3))
    triangles[16:18, 2] = triangles[16:18, 1]
    triangles[18:26] = triangles[18] + (0, 0, 1e-6) * np.arange(8)[:, None, None]
    positions = triangles.reshape(-1, 3)
    indices = np.arange(450).reshape(-1, 3)
    shared = rng.integers(60, 450, (30, 3))
    indices = np.concatenate([indices, shared, indices[30:50], np.roll(indices[50:60], 1, axis=1)])
    return positions, rng.permutation(indices)


def camera(width: int = 61, height: int = 45, **changes: Any) -> Camera:
    focal = 0.9 * width
    front = Camera(width, height, focal, 1.1 * focal, width / 2, height / 2, np.eye(4))
    return replace(front, **changes)


def draw(device: Device, asset: Asset, seen_by: Camera, background: Any = BLACK, **options: Any) -> Frame:
    return frame_of(DiffSoupPipeline, asset, device, seen_by, background, **options)


@pytest.mark.slow
@pytest.mark.parametrize("level", range(6))
@pytest.mark.parametrize("quantised", [False, True], ids=["numbers", "bytes"])
def test_reference(device: Device, level: int, quantised: bool) -> None:
    layout = ("colmap", "synthetic")[(level + quantised) % 2]
    settings = {"layout": layout, "z_near": 0.2, "z_far": 100.0}
    asset = lattice_model(*soup(level), level, seed=level, quantised=quantised, settings=settings)
    seen_by = camera(cx=28.3, cy=24.9) if level % 3 == 0 else camera(64, 37)
    frame = draw(device, asset, seen_by, (0.25, 0.5, 0.75))
    expected = render_reference(asset, seen_by, (0.25, 0.5, 0.75))
    assert (expected.face_id >= 0).mean() > 0.3
    same = frame.face_id == expected.face_id
    if device.record.correctly_rounded:  # then everything before the decoder matches the reference exactly
        assert same.all()
        assert frame.raw["num_fragments"] == expected.raw["num_fragments"]
        for name in ("mvp", "mvp_inv", "bary01", "depth", "features", "sh"):
            np.testing.assert_array_equal(frame.raw[name], expected.raw[name], err_msg=name)
        np.testing.assert_array_equal(frame.visible, expected.visible)
        np.testing.assert_array_equal(frame.depth, expected.depth)
    assert same.mean() > 0.995
    assert np.abs(frame.image - expected.image)[same].max() < 1e-5


@pytest.mark.slow
def test_lowest_of_equal_triangles_wins(device: Device) -> None:
    positions = np.array([[-2, -2, 3], [2, -2, 3], [0, 3, 3]])
    for count in (2, 9, 40):
        asset = lattice_model(positions, np.tile([0, 1, 2], (count, 1)), 1, opacity=np.ones((count, 6)))
        frame = draw(device, asset, camera(33, 20))
        assert set(np.unique(frame.face_id)) == {-1, 0}
        assert frame.visible.tolist() == [True] + [False] * (count - 1)
        assert frame.raw["num_fragments"] == count * frame.alpha.sum()


def test_opacity_threshold_keeps_a_half(device: Device) -> None:
    positions = np.array([[-2, -2, 3], [2, -2, 3], [0, 3, 3.5], [-2, -2, 4], [2, -2, 4], [0, 3, 4]])
    opacity = np.full((2, 3), 0.5)
    opacity[0] = np.nextafter(np.float32(0.5), np.float32(0)) - 1e-6
    asset = lattice_model(positions, np.arange(6).reshape(2, 3), 0, opacity=opacity)
    frame = draw(device, asset, camera(40, 31))
    expected = render_reference(asset, camera(40, 31))
    np.testing.assert_array_equal(frame.face_id, expected.face_id)
    assert set(np.unique(frame.face_id)) == {-1, 1}


@pytest.mark.slow
def test_many_triangles_in_one_tile(device: Device) -> None:
    """Each of 100,000 triangles covers the whole image, and the nearest one is visible."""
    count = 100_000
    depth = np.random.default_rng(0).permutation(np.linspace(3, 9, count))
    corners = np.array([[-20, -20], [20, -20], [0, 20]]) * depth[:, None, None] / 9
    positions = np.concatenate([corners, np.repeat(depth, 3).reshape(-1, 3, 1)], axis=2)
    positions[77_777, :, 2] = 2.9
    indices = np.arange(3 * count).reshape(-1, 3)
    asset = lattice_model(positions.reshape(-1, 3), indices, 0, opacity=np.ones((count, 3)))
    frame = draw(device, asset, camera(16, 16), outputs=())
    assert (frame.face_id == 77_777).all()
    np.testing.assert_allclose(frame.depth, 2.9, rtol=1e-6)


def test_near_plane_cuts_pixels(device: Device) -> None:
    positions = np.array([[-2, -2, 3], [2, -2, 3], [0, 3, 0.3]])
    asset = lattice_model(positions, np.array([[0, 1, 2]]), 0, opacity=np.ones((1, 3)))
    depth = draw(device, asset, camera()).depth
    assert depth.any()
    assert depth[depth > 0].min() >= 0.4999
