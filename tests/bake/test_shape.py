"""The shape measures give known values for known surfaces."""

import math

import numpy as np
import pytest

from data_stubs.surface import icosphere
from msb.bake.shape import compare_with_truth, measure_bending, measure_visible_bending
from msb.meshes.mesh import Mesh
from msb.scenes import Camera
from tests.bake.soups import all_round
from tests.bake.test_fairing import box, dented


def ball(parts: int = 10) -> Mesh:
    points, faces = icosphere(parts)
    return Mesh(points.astype(np.float32), faces.astype(np.int64))


def plane(tilt: float, z: float = 0.0) -> Mesh:
    """Return a large square in front of the camera at (0, 0, -4), tilted by `tilt` degrees."""
    slope = math.tan(math.radians(tilt))
    corners = [(x, y, z + slope * x) for x in (-3, 3) for y in (-3, 3)]
    return Mesh(np.array(corners, np.float32), np.array([[0, 1, 2], [2, 1, 3]], np.int64))


FRONT = [Camera.look_at((0, 0, -4), (0, 0, 0), width=32, height=32, fov_y=0.5)]


def test_a_cube_bends_at_its_edges_only() -> None:
    points, faces = box(4)
    shape = measure_bending(points, faces, np.ones(len(faces), bool), size=2.0)
    assert shape.bending == pytest.approx(2 * np.pi)
    assert shape.creases == pytest.approx(4.0)
    # Vertices that are doubled for seams change nothing, and neither does the winding of single faces.
    soup = points[faces].reshape(-1, 3)
    numbers = np.arange(len(soup)).reshape(-1, 3)
    numbers[::3] = numbers[::3, ::-1]
    assert measure_bending(soup, numbers, np.ones(len(faces), bool)).bending == pytest.approx(np.pi)


def test_a_ball_bends_twice_per_radius() -> None:
    views = all_round(4, (-2, 0, 2))
    shape = measure_visible_bending(ball(), views)
    # The size is the diagonal of the box without the outermost percent, 2 sqrt(3) at most.
    assert shape.bending == pytest.approx(2 * 2 * math.sqrt(3), rel=0.1)
    assert shape.creases == 0
    mesh = ball()
    rough = Mesh(dented(mesh.vertices.astype(np.float64), 0.02).astype(np.float32), mesh.faces)
    assert measure_visible_bending(rough, views).bending > 3 * shape.bending


@pytest.mark.parametrize("tilt", [0.0, 10.0, 40.0])
def test_the_angle_to_the_truth_is_that_between_the_planes(tilt: float) -> None:
    shape = compare_with_truth(plane(tilt), plane(0.0), FRONT)
    assert (shape.mean, shape.median) == pytest.approx((tilt, tilt), abs=0.01)
    assert shape.above_30 == (tilt > 30)
    turned = Mesh(plane(tilt).vertices, plane(tilt).faces[:, ::-1].copy())
    assert compare_with_truth(turned, plane(0.0), FRONT).mean == pytest.approx(tilt, abs=0.01)


def test_smooth_normals_of_a_ball_are_nearer_to_the_truth_than_flat_ones() -> None:
    shape = compare_with_truth(ball(6), ball(24), all_round(4, (0,)))
    assert shape.smooth_mean < shape.mean / 2
    assert shape.outline > 0.95


def test_surfaces_at_other_depths_are_not_compared() -> None:
    shape = compare_with_truth(plane(0, z=1.0), plane(0), FRONT)
    assert math.isnan(shape.mean)
    assert (shape.excluded, shape.outline) == (1.0, 1.0)
