"""Faces that share edges: every sample belongs to exactly one of them, at any position and size."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from msb.cl import Device
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from tests.reference.standard import UNITS, inside
from tests.render.standard_scenes import camera, mesh_asset

VIEW = camera(72, 56, 60.0)


def fan(
    seed: int, radius: float, corners: int, middle: tuple[float, float], tilt: float = 0.0
) -> NDArray[Any]:
    """Return a closed fan around a point of the image, in pixels, as triangles (F, 3, 3) near z = 2."""
    random = np.random.default_rng(seed)
    angles = np.sort(random.uniform(0, 2 * np.pi, corners) + np.arange(corners) * 0.0)
    angles = (angles + np.arange(corners) * 2 * np.pi / corners) / 2 + random.uniform(0, 6)
    around = radius * random.uniform(0.6, 1.0, corners)
    ring = np.stack([np.cos(angles) * around, np.sin(angles) * around], axis=-1) + middle
    points = np.concatenate([[middle], ring])
    depth = 2 + tilt * (points[:, 1:] - middle[1]) / radius
    local = np.concatenate([(points - (VIEW.cx, VIEW.cy)) / (VIEW.fx, VIEW.fy) * 2, depth], axis=1)
    number = np.arange(corners)
    faces = np.stack([np.zeros(corners, int), 1 + number, 1 + (number + 1) % corners], axis=-1)
    faces[::2] = faces[::2][:, [1, 0, 2]]  # the windings differ, because faces are two-sided
    return local[faces].astype(np.float32)


def coverage(device: Device, triangles: NDArray[Any], view: Camera = VIEW) -> NDArray[np.int64]:
    """Return how many of the triangles cover each pixel, each drawn separately."""
    count = np.zeros((view.height, view.width), np.int64)
    for triangle in triangles:
        mesh = triangle.reshape(3, 3), np.array([[0, 1, 2]], np.uint32)
        renderer = StandardRenderer(mesh_asset(mesh), device=device)
        count += renderer.render(view, (0, 0, 0)).alpha.astype(np.int64)
        renderer.close()
    return count


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius", "middle"),
    [
        (20.0, (30.5, 25.5)),  # the common corner lies on a sample
        (25.0, (33.123, 27.871)),
        (6.0, (40.0, 20.0)),  # between samples
        (2.2, (12.37, 44.4)),
        (0.7, (50.5, 30.5)),
        (0.01, (50.5, 30.5)),
        (500.0, (30.1, 22.2)),
        (3e6, (35.3, 26.1)),  # past the guard band
    ],
)
def test_closed_fans(styled: Device, radius: float, middle: tuple[float, float]) -> None:
    triangles = fan(int(radius), radius, 7, middle)
    count = coverage(styled, triangles)
    assert count.max() <= 1
    if radius >= 500:
        assert (count == 1).all()
    elif radius >= 6:
        y, x = np.mgrid[:56, :72] + 0.5
        assert (count[np.hypot(x - middle[0], y - middle[1]) < 0.3 * radius] == 1).all()
    # The whole fan covers the same pixels as its faces.
    mesh = triangles.reshape(-1, 3), np.arange(21, dtype=np.uint32).reshape(7, 3)
    renderer = StandardRenderer(mesh_asset(mesh), device=styled)
    np.testing.assert_array_equal(renderer.render(VIEW, (0, 0, 0)).alpha, count)
    renderer.close()


@pytest.mark.slow
def test_fan_through_the_near_plane(styled: Device) -> None:
    """Both faces at a clipped edge get the same point on the near plane."""
    triangles = fan(3, 40.0, 9, (36.2, 28.7), tilt=-6.0)
    assert triangles[..., 2].min() < 0 < 0.01 < triangles[..., 2].max()
    count = coverage(styled, triangles)
    assert count.max() == 1
    covered = count == 1
    assert covered.sum() > 300
    # No holes: the covered pixels of a row are contiguous.
    for row in covered:
        assert np.count_nonzero(np.diff(np.concatenate([[0], row, [0]]))) <= 2


coordinates = st.integers(-3 * UNITS, 20 * UNITS)
points = st.tuples(coordinates, coordinates)


@settings(max_examples=100)
@given(points, points, points, points)
def test_rule_of_the_twin(a: Any, b: Any, c: Any, d: Any) -> None:
    """Two triangles have a common edge.

    The triangles are anywhere on the grid, and samples lie on their edges.
    """

    def side(p: Any) -> int:
        return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])

    if side(c) * side(d) >= 0:
        return
    count = np.zeros((16, 16), int)
    for corner in (c, d):
        y, x = inside(np.array([a, b, corner]), 16, 16)
        count[y, x] += 1
    assert count.max(initial=0) <= 1
    on_edge = [
        (x, y)
        for x in range(16)
        for y in range(16)
        if side((x * UNITS + UNITS // 2, y * UNITS + UNITS // 2)) == 0
        and min(a[0], b[0]) < x * UNITS + UNITS // 2 < max(a[0], b[0])
    ]
    assert all(count[y, x] == 1 for x, y in on_edge)
