"""The Gaussians of an asset: their buffers, their activation, and their placeholder triangles."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.activation import exponential, sigmoid
from msb.asset.drawable import require, required_buffer
from msb.splats.gaussians import Gaussians, Reals

MEAN, SCALE, ROTATION = "gauss.mean", "gauss.scale", "gauss.rotation"
# Distance from the mean to a corner of the placeholder triangle at opacity 1, in standard deviations. The
# area of the equilateral triangle is then 2 pi, the integral of the Gaussian over the plane of its two longer
# axes.
_REACH = np.sqrt(2 * np.pi / (3 * np.sqrt(3) / 4))
_CORNERS = np.deg2rad([90, 210, 330])
# Number of Gaussians whose placeholders are computed at a time, to limit temporary memory.
_CHUNK = 1 << 17


class Activated(NamedTuple):
    """Activated parameters: mean (N, 3), deviation (N, 2 | 3), rotation (N, 3, 3) and opacity (N,)."""

    mean: Reals
    deviation: Reals
    rotation: Reals
    opacity: Reals


def make_buffers(gaussians: Gaussians) -> dict[str, NDArray[Any]]:
    """Return the buffers of an asset: the stored parameters, and a placeholder triangle per Gaussian.

    Each buffer except `positions` and `indices` has one row for each face.
    """
    count = len(gaussians.mean)
    buffers: dict[str, NDArray[Any]] = {
        "positions": _make_stand_ins(gaussians).reshape(3 * count, 3),
        "indices": np.arange(3 * count, dtype=np.uint32).reshape(count, 3),
        "f_dc": gaussians.f_dc,
        "opacity": gaussians.opacity,
        MEAN: gaussians.mean,
        SCALE: gaussians.scale,
        ROTATION: gaussians.rotation,
    }
    if gaussians.f_rest is not None:
        buffers["f_rest"] = gaussians.f_rest.reshape(count, -1)
    return buffers


def _make_stand_ins(gaussians: Gaussians) -> NDArray[np.float32]:
    """Return a triangle (N, 3, 3) for each Gaussian, in the plane of its two longer axes.

    The triangle's area is the integral of the Gaussian's opacity over this plane.
    """
    corners = np.zeros((len(gaussians.mean), 3, 3), np.float32)
    turn = np.stack([np.cos(_CORNERS), np.sin(_CORNERS)])
    for start in range(0, len(corners), _CHUNK):
        part = slice(start, start + _CHUNK)
        with np.errstate(over="ignore", invalid="ignore"):
            deviation = np.exp(gaussians.scale[part].astype(np.float64))
            axes = rotation_matrices(gaussians.rotation[part].astype(np.float64))
            # The two longer axes (n, 3, 2). The length of each axis is one standard deviation.
            longest = np.argsort(-deviation, axis=1, kind="stable")[:, :2]
            length = np.take_along_axis(deviation, longest, axis=1)
            arms = np.take_along_axis(axes, longest[:, None, :], axis=2) * length[:, None, :]
            reach = _REACH / np.sqrt(1 + np.exp(-gaussians.opacity[part].astype(np.float64)))
            offsets = reach[:, None, None] * (arms @ turn).transpose(0, 2, 1)
            corners[part] = gaussians.mean[part, None, :] + offsets
    return corners


def rotation_matrices(quaternions: Reals) -> Reals:
    """Return rotation matrices (N, 3, 3) of quaternions (N, 4) w, x, y, z, which are normalised first.

    In float32, the operations follow the order of torch's `normalize` and of the official kernels.
    """
    real, q = quaternions.dtype.type, quaternions
    length = np.sqrt(q[:, 0] * q[:, 0] + q[:, 1] * q[:, 1] + q[:, 2] * q[:, 2] + q[:, 3] * q[:, 3])
    w, x, y, z = (q / np.maximum(length, real(1e-12))[:, None]).T
    unit, two = real(1), real(2)
    rows = [
        [unit - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), unit - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), unit - two * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def activate(asset: Asset, axes: int, real: type[Any] = np.float32) -> Activated:
    """Return the activated parameters of an asset's Gaussians; `real` is the type of the numbers.

    The number `axes` is 3, or 2 for flat discs.

    Raises
    ------
    AssetError
        TRIASSET_BUFFER or TRIASSET_FIELD: a buffer is missing, or has a wrong shape or encoding.
    """
    require(asset, "opacity", "encoding", "logit")
    count = asset.manifest.face_count
    mean = required_buffer(asset, MEAN, count, 3).astype(real)
    scale = required_buffer(asset, SCALE, count, axes)
    rotation = required_buffer(asset, ROTATION, count, 4).astype(real)
    opacity = required_buffer(asset, "opacity", count)
    if real is np.float32:
        return Activated(mean, exponential(scale), rotation_matrices(rotation), sigmoid(opacity))
    with np.errstate(over="ignore"):
        share = 1 / (1 + np.exp(-opacity.astype(real)))
    return Activated(mean, np.exp(scale.astype(real)), rotation_matrices(rotation), share)


def covariances(deviation: Reals, rotation: Reals) -> Reals:
    """Return the covariance R S S R^T as xx, xy, xz, yy, yz, zz (N, 6). Each sum runs from the first axis to
    the last."""
    m = rotation * deviation[:, None, :]
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    terms = [m[:, i] * m[:, j] for i, j in pairs]
    return np.stack([term[:, 0] + term[:, 1] + term[:, 2] for term in terms], axis=1)
