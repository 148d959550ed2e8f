"""Invert small matrices without LAPACK."""

import numpy as np
from numpy.typing import NDArray


def inverse(matrix: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the inverse of a matrix (N, N) as float64.

    A singular matrix gives infinities or NaN, with warnings. Use this function for the few matrices that are
    needed to draw a frame. With OpenBLAS 0.3.23 (NumPy 1.26), `numpy.linalg.inv` wakes all threads even for a
    3 x 3 matrix. The threads then wait actively for 25 ms. While the threads wait, OpenCL kernels have only
    half of the processor, so drawing a frame takes twice as long.
    """
    size = len(matrix)
    rows = np.concatenate([matrix, np.eye(size)], axis=1)
    # Gauss-Jordan elimination with partial pivoting on the rows of [matrix | identity], (N, 2 N).
    for column in range(size):
        pivot = column + np.abs(rows[column:, column]).argmax()
        rows[[column, pivot]] = rows[[pivot, column]]
        rows[column] /= rows[column, column]
        factors = rows[:, column].copy()
        factors[column] = 0
        rows -= factors[:, None] * rows[column]
    inverted: NDArray[np.float64] = rows[:, size:].copy()
    return inverted
