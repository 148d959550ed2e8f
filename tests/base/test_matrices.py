from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.base.matrices import inverse


def exact_inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the adjugate divided by the determinant, computed with fractions and rounded at the end."""
    rows = [[Fraction(float(value)) for value in row] for row in matrix]

    def minor(of: list[list[Fraction]], row: int, column: int) -> list[list[Fraction]]:
        return [[*line[:column], *line[column + 1 :]] for at, line in enumerate(of) if at != row]

    def determinant(of: list[list[Fraction]]) -> Fraction:
        if not of:
            return Fraction(1)
        return sum(
            (
                (-1) ** column * value * determinant(minor(of, 0, column))
                for column, value in enumerate(of[0])
            ),
            Fraction(0),
        )

    whole, size = determinant(rows), range(len(rows))
    adjugate = [[(-1) ** (i + j) * determinant(minor(rows, j, i)) / whole for j in size] for i in size]
    return np.array(adjugate, np.float64)


@pytest.mark.parametrize("size", [1, 3, 4])
def test_the_inverse_agrees_with_exact_arithmetic(size: int) -> None:
    rng = np.random.default_rng(size)
    for number in range(50):
        matrix = rng.normal(size=(size, size)) * 10.0 ** rng.integers(-3, 4, size)
        if number % 2 and size > 1:
            matrix[0, 0] = 0  # a matrix that needs pivoting: the first pivot is not in row 0
        before = matrix.copy()
        expected = exact_inverse(matrix)
        condition = np.linalg.norm(matrix) * np.linalg.norm(expected)
        error = np.linalg.norm(inverse(matrix) - expected) / np.linalg.norm(expected)
        assert error <= 4 * condition * np.finfo(np.float64).eps
        np.testing.assert_array_equal(matrix, before)


def test_a_permutation_is_inverted_exactly() -> None:
    turned = np.eye(4)[[2, 0, 3, 1]]
    np.testing.assert_array_equal(inverse(turned), turned.T)


def test_a_singular_matrix_has_no_finite_inverse() -> None:
    with np.errstate(all="ignore"):
        assert not np.isfinite(inverse(np.ones((3, 3)))).all()
