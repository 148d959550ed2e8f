"""Parts of the formulas against exact arithmetic."""

import numpy as np
import pytest

from msb.asset.sh import SH_C0, sh_basis
from msb.methods.diffsoup.reference import interpolate
from msb.methods.mesh_splatting.reference import box_mean
from msb.methods.two_dts.reference import resize, straight_through
from msb.reference.arithmetic import fast_power, power, sigmoid
from msb.reference.sh import colors_from_sh

F = np.float32


def test_harmonics_are_orthonormal() -> None:
    """Integrate over the sphere with a quadrature that is exact for products of functions of degree 3."""
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


def test_the_threshold_is_strict() -> None:
    opacity = np.array([0.2, 0.3, 0.30000004, 0.9], F)
    np.testing.assert_allclose(straight_through(opacity, 0.3), [0, 0, 1, 1], atol=2e-7)
    assert straight_through(opacity, 0.3)[0] == 0


@pytest.mark.parametrize("scale", [1, 2, 3, 4, 5])
def test_resize_is_exact_for_linear_images(scale: int) -> None:
    """Bilinear interpolation at pixel centres, like torch's with align_corners=False."""
    rows, columns = np.mgrid[0 : 4 * scale, 0 : 6 * scale].astype(np.float64)
    small = resize(2 * rows - columns, scale)
    y, x = np.mgrid[0:4, 0:6]
    np.testing.assert_allclose(small, 2 * ((y + 0.5) * scale - 0.5) - ((x + 0.5) * scale - 0.5))
    assert resize(np.zeros((4 * scale, 6 * scale, 3), F), scale).shape == (4, 6, 3)
    np.testing.assert_allclose(box_mean(2 * rows - columns, scale), small, atol=1e-12)


@pytest.mark.parametrize("level", [0, 1, 2, 5])
def test_lattices_are_linear_between_their_nodes(level: int) -> None:
    """Sample s(s + 1)/2 + y is the node (x, y) with s = x + y. Linear lattices are interpolated exactly."""
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
    values = interpolate(lattice, 1, level, b[:, 0], b[:, 1])[:, 0]
    np.testing.assert_allclose(values, 3 * b[:, 0] - 2 * b[:, 1] + 1, atol=1e-12)
    assert values[-3:].tolist() == pytest.approx([4, -1, 1])
    assert lattice[1, 0, 0] == 1  # sample 0 is vertex 2
