"""The inverse of a small matrix, without LAPACK."""

import numpy as np
from numpy.typing import NDArray


def inverse(matrix: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the inverse of a (N, N) matrix in float64, by Gauss-Jordan elimination with partial pivoting.

    It is for the few matrices of every frame. `numpy.linalg.inv` of even a 3 x 3 matrix wakes the threads of
    OpenBLAS up to 0.3.23 (NumPy 1.26), which then wait for more work by spinning: they took half of the
    processor from the kernels for the next 25 ms, and frames took twice their time.

    A singular matrix gives infinities or NaN, and NumPy's warnings where the caller does not silence them.
    """
    size = len(matrix)
    rows = np.concatenate([matrix, np.eye(size)], axis=1)
    for column in range(size):
        pivot = column + np.abs(rows[column:, column]).argmax()
        rows[[column, pivot]] = rows[[pivot, column]]
        rows[column] /= rows[column, column]
        factors = rows[:, column].copy()
        factors[column] = 0
        rows -= factors[:, None] * rows[column]
    inverted: NDArray[np.float64] = rows[:, size:].copy()
    return inverted
