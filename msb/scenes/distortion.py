"""Lens distortion: conversion of ideal pinhole coordinates into the coordinates of a real lens.

All functions use normalised coordinates x / z, y / z in the camera's axes, without focal lengths and
principal point. Coefficients have the names and the order of COLMAP (`colmap/colmap`:
src/colmap/sensor/models.h). The formulas come from the OpenCV documentation (calib3d, fisheye), from COLMAP
and from nerfstudio (cameras).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.errors import SceneError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Distortion:
    """The distortion of a lens: a model of `DISTORTIONS`, and the coefficients in the model's order.

    Coefficients apply to normalised coordinates, so they do not depend on the image size.
    """

    model: str
    coefficients: tuple[float, ...] = ()

    def apply(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return distorted normalised coordinates for the ideal coordinates.

        All arrays have the same shape.
        """
        with np.errstate(all="ignore"):  # coordinates far outside the image may overflow
            return DISTORTIONS[self.model](x, y, self.coefficients)


def make_distortion(model: str, coefficients: Sequence[float]) -> Distortion | None:
    """Return the distortion of a lens. If the lens does not distort, return None.

    Raise CAMERA_DISTORTED if a coefficient is not finite.
    """
    if not np.isfinite(coefficients).all():
        values = ", ".join(f"{value:g}" for value in coefficients)
        raise SceneError("CAMERA_DISTORTED", f"the coefficients of {model} are {values}; they must be finite")
    if model in _CURVED or any(coefficients):
        return Distortion(model, tuple(float(value) for value in coefficients))
    return None


def _polynomial(square: Array, factors: Sequence[float]) -> Array:
    """Return 1 + k1 s + k2 s^2 + ..., where s is `square`."""
    result = np.zeros_like(square)
    for factor in reversed(factors):
        result = (result + factor) * square
    return 1 + result


def _distort_brown(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    """Model OPENCV or FULL_OPENCV with coefficients k1, k2, p1, p2 and, if present, k3, k4, k5, k6."""
    k1, k2, p1, p2, k3, *below = (*c, 0.0, 0.0, 0.0, 0.0)[: max(len(c), 5)]
    square = x * x + y * y
    radial = _polynomial(square, (k1, k2, k3)) / _polynomial(square, below)
    return _bend(x, y, radial, p1, p2)


def _bend(x: Array, y: Array, radial: Array | float, p1: float, p2: float) -> tuple[Array, Array]:
    """Return radial distortion plus tangential distortion with p1 (vertical) and p2 (horizontal)."""
    square = x * x + y * y
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y),
    )


def _distort_radial(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    radial = _polynomial(x * x + y * y, c)
    return x * radial, y * radial


def _distort_nerfstudio(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    """Model OPENCV in nerfstudio's form: k1, k2, k3, k4 (all in the numerator), p1, p2."""
    return _bend(x, y, _polynomial(x * x + y * y, c[:4]), c[4], c[5])


def _fisheye(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the equidistant projection, which uses the angle to the optical axis instead of its tangent."""
    radius = np.hypot(x, y)
    scale = np.where(radius > 1e-12, np.arctan(radius) / np.maximum(radius, 1e-12), 1.0)
    return x * scale, y * scale


def _distort_fisheye(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    return _distort_radial(*_fisheye(x, y), c)


def _distort_thin_prism(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    k1, k2, p1, p2, k3, k4, sx, sy = c
    x, y = _fisheye(x, y)
    square = x * x + y * y
    right, down = _bend(x, y, _polynomial(square, (k1, k2, k3, k4)), p1, p2)
    return right + sx * square, down + sy * square


def _distort_aria(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    """Model RAD_TAN_THIN_PRISM_FISHEYE (nerfstudio: FISHEYE624) with k0 to k5, p0, p1, s0 to s3."""
    x, y = _distort_fisheye(x, y, c[:6])
    square = x * x + y * y
    right, down = _bend(x, y, 1.0, c[7], c[6])
    s0, s1, s2, s3 = c[8:]
    return right + square * (s0 + s1 * square), down + square * (s2 + s3 * square)


def _distort_fov(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    radius = np.maximum(np.hypot(x, y), 1e-12)
    scale = np.arctan(2 * radius * np.tan(c[0] / 2)) / (radius * c[0])
    return x * scale, y * scale


def _distort_division(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    scale = 2 / (1 + np.sqrt(1 - 4 * c[0] * (x * x + y * y)))
    return x * scale, y * scale


def _distort_eucm(x: Array, y: Array, c: Sequence[float]) -> tuple[Array, Array]:
    alpha, beta = c
    scale = 1 / (alpha * np.sqrt(beta * (x * x + y * y) + 1) + 1 - alpha)
    return x * scale, y * scale


# The distortion function of each model. The arguments of a distortion function are x, y and the coefficients.
# The model NERFSTUDIO is not a COLMAP model.
DISTORTIONS: dict[str, Callable[[Array, Array, Sequence[float]], tuple[Array, Array]]] = {
    "SIMPLE_RADIAL": _distort_radial,
    "RADIAL": _distort_radial,
    "OPENCV": _distort_brown,
    "FULL_OPENCV": _distort_brown,
    "NERFSTUDIO": _distort_nerfstudio,
    "OPENCV_FISHEYE": _distort_fisheye,
    "SIMPLE_RADIAL_FISHEYE": _distort_fisheye,
    "RADIAL_FISHEYE": _distort_fisheye,
    "SIMPLE_FISHEYE": _distort_fisheye,
    "FISHEYE": _distort_fisheye,
    "THIN_PRISM_FISHEYE": _distort_thin_prism,
    "RAD_TAN_THIN_PRISM_FISHEYE": _distort_aria,
    "FOV": _distort_fov,
    "SIMPLE_DIVISION": _distort_division,
    "DIVISION": _distort_division,
    "EUCM": _distort_eucm,
}
# Fisheye models. Fisheye models distort the image even if all coefficients are zero.
_CURVED = {name for name in DISTORTIONS if "FISHEYE" in name}
