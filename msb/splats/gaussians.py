"""The stored parameters of Gaussian splats, and conversions that several file formats share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.sh import SH_C0, sh_basis
from msb.errors import CheckpointError

Reals = NDArray[np.floating[Any]]
# Maps the number of SH coefficients per channel to the SH degree. The number excludes the coefficient of
# degree 0.
DEGREES = {(degree + 1) ** 2 - 1: degree for degree in range(5)}
# Minimum linear scale for formats that do not store the logarithm of scales.
_MIN_SCALE = 1e-30


@dataclass(frozen=True, eq=False)
class Gaussians:
    """A set of `N` Gaussians with the stored parameters of 3DGS, before activation. The axes are x right, y
    down, z forward.

    Attributes
    ----------
    mean : (N, 3) float32
    scale : (N, 3) float32
        Natural logarithms of the standard deviations. The shape is (N, 2) for the flat discs of 2DGS.
        rotation : (N, 4) float32 Quaternions w, x, y, z of any length.
    opacity : (N,) float32
        Logits of the opacities; infinite for opacities of exactly 0 and 1.
    f_dc : (N, 3) float32
        SH coefficients of degree 0.
    f_rest : (N, K, 3) float32 or None
        The SH coefficients of degree 1 and higher.
    antialiased : bool or None
        Whether the model was trained with compensated opacities; None if the file does not state this.
    notes : tuple of str
        Properties of the file that were not read.
    """

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    rotation: NDArray[np.float32]
    opacity: NDArray[np.float32]
    f_dc: NDArray[np.float32]
    f_rest: NDArray[np.float32] | None = None
    antialiased: bool | None = None
    notes: tuple[str, ...] = ()

    @property
    def degree(self) -> int:
        """The SH degree."""
        return 0 if self.f_rest is None else DEGREES[self.f_rest.shape[1]]


def damaged(text: str) -> CheckpointError:
    """Return the error for a splat file whose content is damaged or truncated."""
    return CheckpointError("CHECKPOINT_DAMAGED", text)


def check_count(count: int) -> None:
    """Reject a file without Gaussians."""
    if count < 1:
        raise CheckpointError("CHECKPOINT_LAYOUT", "the file contains no Gaussians")


def to_logit(opacity: Reals) -> NDArray[np.float32]:
    """Return the logits log(o / (1 - o)) as float32; opacities 0 and 1 give infinite logits."""
    with np.errstate(divide="ignore"):
        return (np.log(opacity) - np.log1p(-opacity)).astype(np.float32)


def to_log(scale: Reals) -> NDArray[np.float32]:
    """Return the logarithms of linear scales as float32; a tiny scale replaces a scale of 0."""
    return np.log(np.maximum(scale, _MIN_SCALE)).astype(np.float32)


def to_f_dc(color: Reals) -> NDArray[np.float32]:
    """Return SH coefficients of degree 0 for colours in [0, 1]."""
    return ((color - 0.5) / SH_C0).astype(np.float32)


def expand_quaternions(largest: NDArray[np.integer[Any]], others: Reals) -> Reals:
    """Return quaternions (N, 4) from their three smallest components.

    `others` (N, 3) contains the three stored components in ascending order of their indices. The component
    with the index `largest` (N,) is not stored. The missing component is positive, and the quaternion has
    length 1.
    """
    rotation = np.zeros((len(others), 4))
    columns = np.array([[k for k in range(4) if k != left_out] for left_out in range(4)])
    np.put_along_axis(rotation, columns[largest], others, axis=1)
    last = np.sqrt(np.maximum(0, 1 - np.square(others).sum(axis=1)))
    np.put_along_axis(rotation, largest[:, None].astype(np.intp), last[:, None], axis=1)
    return rotation


def turn_about_x(gaussians: Gaussians) -> Gaussians:
    """Return the Gaussians rotated by half a turn about x. This rotation converts between our frame and the
    frame x right, y up, z back.

    The function negates y and z of the means and of the quaternions. The function also negates the SH
    coefficients of each basis function that changes its sign under the rotation.
    """
    flip = np.array([1, -1, -1], np.float32)
    f_rest = gaussians.f_rest
    if f_rest is not None:
        # Find the sign of each basis function at a rotated direction.
        direction = np.array([[0.48, -0.6, 0.64]])
        values, turned = (
            np.array(sh_basis(d, gaussians.degree))[:, 0] for d in (direction, direction * flip)
        )
        f_rest = f_rest * np.sign(values * turned).astype(np.float32)[:, None]
    rotation = gaussians.rotation * np.array([1, *flip], np.float32)
    return replace(gaussians, mean=gaussians.mean * flip, rotation=rotation, f_rest=f_rest)


def transform(gaussians: Gaussians, rotation: Reals, size: float, offset: Reals) -> Gaussians:
    """Return the Gaussians after the map p -> `size` `rotation` p + `offset`, with their view-dependent
    colours.

    `rotation` is a rotation matrix (3, 3).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        mean = gaussians.mean.astype(np.float64) @ (size * rotation).T + offset
    w, x, y, z = _to_quaternion(rotation)
    a, b, c, d = gaussians.rotation.astype(np.float64).T
    product = np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=1,
    )
    return replace(
        gaussians,
        mean=mean.astype(np.float32),
        scale=gaussians.scale + np.float32(np.log(size)),
        rotation=product.astype(np.float32),
        f_rest=None if gaussians.f_rest is None else _rotate_sh(gaussians.f_rest, gaussians.degree, rotation),
    )


def _to_quaternion(rotation: Reals) -> Reals:
    """Return the quaternion (4,) w, x, y, z of a rotation matrix.

    The quaternion is the dominant eigenvector of a 4 x 4 matrix (Bar-Itzhack 2000). This method needs no
    special case for small w.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    vector: Reals = np.linalg.eigh(matrix)[1][:, -1]
    return vector


def _rotate_sh(rest: NDArray[np.float32], degree: int, rotation: Reals) -> NDArray[np.float32]:
    """Return SH coefficients (N, K, 3) whose colour at d equals the old colour at R^T d.

    The function samples directions and solves a linear system for each degree.
    """
    directions = np.random.default_rng(0).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    here = np.stack(sh_basis(directions, degree), axis=1)
    there = np.stack(sh_basis(directions @ rotation, degree), axis=1)
    rotated = np.empty_like(rest)
    for order in range(1, degree + 1):
        band = slice(order**2 - 1, (order + 1) ** 2 - 1)
        matrix = np.linalg.lstsq(here[:, band], there[:, band], rcond=None)[0]
        rotated[:, band] = np.einsum("ij,njc->nic", matrix.astype(np.float32), rest[:, band])
    return rotated


def join(parts: list[Gaussians]) -> Gaussians:
    """Return the Gaussians of all parts in order; missing SH coefficients of a part are 0."""
    if len(parts) == 1:
        return parts[0]
    most = max(part.degree for part in parts)
    rests = []
    for part in parts if most else ():
        rest = np.zeros((len(part.mean), (most + 1) ** 2 - 1, 3), np.float32)
        if part.f_rest is not None:
            rest[:, : part.f_rest.shape[1]] = part.f_rest
        rests.append(rest)
    return Gaussians(
        mean=np.concatenate([part.mean for part in parts]),
        scale=np.concatenate([part.scale for part in parts]),
        rotation=np.concatenate([part.rotation for part in parts]),
        opacity=np.concatenate([part.opacity for part in parts]),
        f_dc=np.concatenate([part.f_dc for part in parts]),
        f_rest=np.concatenate(rests) if rests else None,
    )
