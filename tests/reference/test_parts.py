"""The parts of the formulas against what they are in exact arithmetic."""

import math

import numpy as np
import pytest

from msb.asset.sh import SH_C0, sh_basis
from msb.methods.diffsoup.reference import fragments, interpolate, ndc_centers, towards_camera
from msb.methods.mesh_splatting.reference import box_mean
from msb.methods.triangle_splatting.reference import contour_tiles, points_seen
from msb.methods.two_dts.reference import coverage_alpha, rescale, resize, straight_through
from msb.reference.arithmetic import fast_power, ndc_to_pixel, power, sigmoid
from msb.reference.camera_matrices import splatting_camera
from msb.reference.edge_window import project_windows, window_alpha
from msb.reference.sh import colors_from_sh
from tests.reference.soups import front_camera, random_triangles

F = np.float32


def test_harmonics_are_orthonormal() -> None:
    """Over the sphere, by a quadrature that is exact for products of degree 3."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angles = 2 * np.pi * np.arange(16) / 16
    z, phi = (grid.ravel() for grid in np.meshgrid(nodes, angles, indexing="ij"))
    area = np.repeat(weights, 16) * 2 * np.pi / 16
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=1)
    values = np.stack([np.full(len(z), SH_C0), *sh_basis(directions, 3)])
    np.testing.assert_allclose((values * area) @ values.T, np.eye(16), atol=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colors_add_a_half_and_have_no_upper_clamp(degree: int) -> None:
    coefficients = np.zeros((3, 16, 3), F)
    coefficients[:, 0] = [[0, 3, -3], [1, 1, 1], [0, 0, 0]]
    coefficients[2, 1:] = 1
    points = np.array([[0, 0, 2], [1, 0, 0], [0, 3, 0]], F)
    color = colors_from_sh(coefficients, points, np.zeros(3, F), degree)
    np.testing.assert_allclose(color[0], [0.5, 0.5 + 3 * SH_C0, 0], rtol=1e-6)
    assert color[1, 0] == pytest.approx(0.5 + SH_C0)
    assert len(sh_basis(points, degree)) == (degree + 1) ** 2 - 1
    # The direction is +y: B1 is negative there.
    assert color[2, 0] == 0.5 if degree == 0 else color[2, 0] < 0.5


def test_float32_functions_are_rounded_once() -> None:
    x = np.linspace(0.01, 9, 1000, dtype=F)
    np.testing.assert_array_equal(power(x, F(2)), x * x)
    exact = x.astype(np.float64) ** 2.5
    np.testing.assert_allclose(power(x, F(2.5)), exact, rtol=6e-8)
    np.testing.assert_allclose(fast_power(x, F(2.5)), exact, rtol=2e-6)
    with np.errstate(divide="ignore"):
        assert fast_power(np.zeros(1, F), np.full(1, 1e-4, F))[0] == 0
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(sigmoid(np.array([-np.inf, -1000, 0, np.inf], F)), [0, 0, 0.5, 1])


def test_pixels_are_at_integers() -> None:
    edges = np.array([-1, 1], F)
    np.testing.assert_array_equal(ndc_to_pixel(edges, 10), [-0.5, 9.5])
    centers = ndc_centers(10, np.float64)
    np.testing.assert_allclose(ndc_to_pixel(centers, 10), np.arange(10), atol=1e-12)


def test_gamma_rescale_has_the_factors_of_the_paper() -> None:
    triangle = np.array([[[0, 0, 0], [3, 0, 0], [0, 3, 0]]], np.float64)
    for gamma, factor in ((1.0, 0.70711), (50.0, 0.99868)):
        small = rescale(triangle, gamma)
        np.testing.assert_allclose(small.mean(axis=1), triangle.mean(axis=1))
        edges = [np.linalg.norm(shape[0, 1] - shape[0, 0]) for shape in (small, triangle)]
        assert edges[0] / edges[1] == pytest.approx(factor, abs=5e-6)


def test_the_threshold_is_strict() -> None:
    opacity = np.array([0.2, 0.3, 0.30000004, 0.9], F)
    np.testing.assert_allclose(straight_through(opacity, 0.3), [0, 0, 1, 1], atol=2e-7)
    assert straight_through(opacity, 0.3)[0] == 0


def test_coverage_is_a_gaussian_for_gamma_one_and_hard_for_fifty() -> None:
    eccentricity = np.array([[0, 0.5, 0.99, 1.01, 2, 3.4, 10, 10.1, -1e-7, np.nan]], np.float64)
    soft = coverage_alpha(eccentricity, np.array([[0.8]]), np.float64(1))
    np.testing.assert_allclose(soft[0, :7], 0.8 * np.exp(-0.5 * eccentricity[0, :7] ** 2))
    assert not soft[0, 7:].any()
    with np.errstate(over="ignore"):
        hard = coverage_alpha(eccentricity, np.array([[1.0]]), np.float64(50))
    assert (hard[0, :2] == 0.99).all()
    assert hard[0, 4] == 0


@pytest.mark.parametrize("scale", [1, 2, 3, 4, 5])
def test_resize_is_exact_for_linear_images(scale: int) -> None:
    """Bilinear interpolation at pixel centres, as torch's with align_corners=False."""
    rows, columns = np.mgrid[0 : 4 * scale, 0 : 6 * scale].astype(np.float64)
    small = resize(2 * rows - columns, scale)
    y, x = np.mgrid[0:4, 0:6]
    np.testing.assert_allclose(small, 2 * ((y + 0.5) * scale - 0.5) - ((x + 0.5) * scale - 0.5))
    assert resize(np.zeros((4 * scale, 6 * scale, 3), F), scale).shape == (4, 6, 3)
    np.testing.assert_allclose(box_mean(2 * rows - columns, scale), small, atol=1e-12)


def test_windows_are_one_at_the_incentre_and_zero_on_the_edges() -> None:
    view = splatting_camera(front_camera(400, 280), 0.01, 100.0, np.float64)
    windows = project_windows(random_triangles(1).astype(np.float64), view)
    faces = np.flatnonzero(~windows.dropped)[:20]
    assert len(faces) == 20
    one = np.ones((1, 1))
    for face in faces:
        a, b, c = windows.corners[face]
        sides = np.array([np.linalg.norm(b - c), np.linalg.norm(a - c), np.linalg.norm(a - b)])
        incentre = sides @ windows.corners[face] / sides.sum()
        area = abs(np.cross(np.append(b - a, 0), np.append(c - a, 0))[2]) / 2
        np.testing.assert_allclose(windows.inradius[face], -2 * area / sides.sum(), rtol=1e-9)
        halfway = (incentre + (a + b) / 2) / 2
        x, y = np.stack([incentre, halfway, 2 * a - incentre]).T
        alpha = window_alpha(windows.phi(np.array([[face]]), x, y), 0.8 * one, 2.0 * one, 0.99)[0]
        assert alpha[0] == pytest.approx(0.8)
        assert 0 < alpha[1] < 0.8
        assert alpha[2] == 0


def test_tiles_of_triangle_splatting_hold_the_contour_of_one_hundredth() -> None:
    """Every sample with o phi^sigma above 0.01 lies within the corners of the contour."""
    view = splatting_camera(front_camera(400, 280), 0.01, 100.0, np.float64)
    triangles = random_triangles(2).astype(np.float64)
    rng = np.random.default_rng(0)
    opacity, sigma = rng.uniform(0.05, 0.99, len(triangles)), rng.uniform(0.02, 3, len(triangles))
    windows = project_windows(triangles, view)
    rectangles = contour_tiles(windows, opacity, sigma, view)
    rows, columns = (axis.ravel() for axis in np.mgrid[0:280, 0:400].astype(np.float64))
    checked = 0
    for face in np.flatnonzero(~windows.dropped):
        with np.errstate(divide="ignore"):
            one = np.array([[face]])
            alpha = window_alpha(windows.phi(one, columns, rows), opacity[one], sigma[one], 0.99)[0]
        inside = alpha >= 0.01
        if not inside.any():
            continue
        checked += 1
        x, y = columns[inside], rows[inside]
        (left, top), (right, bottom) = rectangles.low[face], rectangles.high[face]
        # A corner just past a tile's first sample does not include that tile (an official quirk).
        assert left <= x.min() // 16
        assert top <= y.min() // 16
        assert x.max() <= 16 * right
        assert y.max() <= 16 * bottom
    assert checked > 20


def test_points_seen() -> None:
    triangles = np.arange(9.0).reshape(1, 3, 3)
    np.testing.assert_array_equal(points_seen(triangles, "centroid"), [[3, 4, 5]])
    np.testing.assert_array_equal(points_seen(triangles, "broadcast_z"), [[5, 5, 5]])


def test_official_barycentrics_are_affine_on_the_screen() -> None:
    view = splatting_camera(front_camera(400, 280), 0.01, 100.0, np.float64)
    windows = project_windows(random_triangles(1).astype(np.float64), view)
    for face in range(20):
        a, b, c = windows.corners[face]
        x, y = np.stack([a, b, c, (a + b) / 2]).T
        b0, b1, b2 = windows.barycentrics(face, x, y)
        np.testing.assert_allclose(b0, [1, 0, 0, 0.5], atol=1e-9)
        np.testing.assert_allclose(b1, [0, 1, 0, 0.5], atol=1e-9)
        np.testing.assert_allclose(b2, [0, 0, 1, 0], atol=1e-9)


@pytest.mark.parametrize("level", [0, 1, 2, 5])
def test_lattices_are_linear_between_their_nodes(level: int) -> None:
    """Sample s(s + 1)/2 + y is the node x, y with s = x + y; a linear lattice is reproduced everywhere."""
    side = 2**level
    count = (side + 1) * (side + 2) // 2
    lattice = np.zeros((2, count, 1))
    for s in range(side + 1):
        for y in range(s + 1):
            lattice[1, s * (s + 1) // 2 + y] = 3 * (s - y) / side - 2 * y / side + 1
    rng = np.random.default_rng(level)
    weights = rng.dirichlet((1, 1, 1), 200)
    corners = np.eye(3)  # vertex 0, 1 and 2
    b = np.concatenate([weights, corners])
    found = interpolate(lattice, 1, level, b[:, 0], b[:, 1])[:, 0]
    np.testing.assert_allclose(found, 3 * b[:, 0] - 2 * b[:, 1] + 1, atol=1e-12)
    assert found[-3:].tolist() == pytest.approx([4, -1, 1])
    assert lattice[1, 0, 0] == 1  # sample 0 is vertex 2


def test_fragments_have_perspective_correct_barycentrics() -> None:
    clip = np.array([[-1, -1, 0, 1], [2, -1, 0, 1], [-4, 8, 2, 4]], np.float64)
    inside = np.array([0.2, 0.3, 0.5]) @ clip
    u, v = inside[:2] / inside[3]
    corners = clip[..., None]
    b0, b1, depth, w, valid = fragments(corners, np.array([u]), np.array([v]))
    assert valid.all()
    assert (b0[0], b1[0]) == pytest.approx((0.2, 0.3))
    assert w[0] == pytest.approx(inside[3])
    assert depth[0] == pytest.approx(inside[2] / inside[3])
    with np.errstate(invalid="ignore", divide="ignore"):
        assert not fragments(corners[[0, 0, 1]], np.array([u]), np.array([v]))[-1].any()


def test_view_directions_point_to_the_camera() -> None:
    from msb.methods.diffsoup.reference import diffsoup_projection

    camera = front_camera()
    _, inverse = diffsoup_projection(camera, "colmap", 0.5, 100.0, np.float64)
    u, v = ndc_centers(40, np.float64)[[3, 30]], ndc_centers(28, np.float64)[[2, 20]]
    x, y = (np.array([3.5, 30.5]) - 20) / 42, (np.array([2.5, 20.5]) - 14) / 45
    rays = -np.stack([x, y, np.ones(2)], axis=1)
    wanted = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(towards_camera(inverse, u, v), wanted, atol=1e-12)


def test_tangents_are_of_half_the_angle() -> None:
    view = splatting_camera(front_camera(), 1.0, 1000.0, np.float64)
    np.testing.assert_allclose(view.tan_fov, [20 / 42, 14 / 45])
    np.testing.assert_allclose(np.diag(view.full_projection)[:2], [42 / 20, 45 / 14])
    assert view.full_projection[2, 2] == pytest.approx(1000 / 999)
    assert math.isclose(view.full_projection[2, 3], -1000 / 999)
