"""Basic operations of all reference renderers, in the evaluation order of the official kernels.

Every function works in the dtype of its arguments, float32 or float64. NumPy rounds after each operation and
never fuses a multiplication with an addition. Therefore float32 arguments give strict IEEE float32 in the
order written here. Exponentials, logarithms and powers are evaluated in double and then rounded. The results
in float32 are correctly rounded on every machine, except for rare double rounding. NumPy's own float32
functions depend on vector libraries.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Floating-point arrays, float32 or float64. Functions return the dtype of their arguments.
Reals = NDArray[Any]


def dot(a: Reals, b: Reals) -> Reals:
    """Return the dot product over the last axis, summed from the first component to the last."""
    total = a[..., 0] * b[..., 0]
    for axis in range(1, a.shape[-1]):
        total = total + a[..., axis] * b[..., axis]
    return np.asarray(total)


def norm(a: Reals) -> Reals:
    """Return the Euclidean length along the last axis."""
    return np.asarray(np.sqrt(dot(a, a)))


def cross(a: Reals, b: Reals) -> Reals:
    """Return the cross product of vectors (..., 3)."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.stack([x, y, z], axis=-1)


def cross_2d(a: Reals | tuple[Reals, Reals], b: Reals | tuple[Reals, Reals]) -> Reals:
    """Return a.x b.y - a.y b.x of vectors (2, ...)."""
    return np.asarray(a[0] * b[1] - a[1] * b[0])


def transform(matrix: Reals, points: Reals) -> Reals:
    """Return the products M (x, y, z, 1) of a matrix M (R, 4) and points (..., 3), as an array (..., R)."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([row[0] * x + row[1] * y + row[2] * z + row[3] for row in matrix], axis=-1)


def rotate(matrix: Reals, vectors: Reals) -> Reals:
    """Return the 3 x 3 part of a matrix M times vectors (..., 3)."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix[:3]], axis=-1)


def matrix_product(a: Reals, b: Reals) -> Reals:
    """Return the matrix product A B, with the terms of each element added from first to last.

    The official code uses torch on a CPU for small float32 products. Torch adds the terms in this order. BLAS
    is not used, because BLAS fuses and reorders the sums.
    """
    return np.stack([dot(a, np.broadcast_to(column, a.shape)) for column in b.T], axis=-1)


def centroid(triangles: Reals) -> Reals:
    """Return (v1 + v2 + v3) / 3 of triangles (..., 3 corners, 3)."""
    return np.asarray((triangles[..., 0, :] + triangles[..., 1, :] + triangles[..., 2, :]) / 3)


def exponential(x: Reals) -> Reals:
    """Return exp(x)."""
    return np.exp(x, dtype=np.float64).astype(x.dtype)


def power(base: Reals, exponent: Reals | float) -> Reals:
    """Return base ** exponent, like C's pow."""
    return np.power(base, exponent, dtype=np.float64).astype(base.dtype)


def fast_power(base: Reals, exponent: Reals) -> Reals:
    """Return exp2(exponent log2(base)) with each step rounded, like fast pow on a GPU.

    The result is 0 for base 0.
    """
    logarithm = np.log2(base, dtype=np.float64).astype(base.dtype)
    return np.asarray(np.exp2(exponent * logarithm, dtype=np.float64).astype(base.dtype))


def sigmoid(logits: Reals) -> Reals:
    """Return 1 / (1 + exp(-x)) with each step rounded, like torch; infinite logits give 0 and 1."""
    return np.asarray(1 / (1 + exponential(-logits)))


def ndc_to_pixel(ndc: Reals, size: int) -> Reals:
    """Return ((ndc + 1) size - 1) / 2, evaluated in double precision and rounded once.

    Pixels are mapped as in the 3DGS family: pixel i has its centre at the integer i, and ndc = -1 is the left
    edge of pixel 0.
    """
    return np.asarray((((ndc.astype(np.float64) + 1) * size - 1) * 0.5).astype(ndc.dtype))
