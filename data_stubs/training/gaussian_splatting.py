"""3DGS' image formation, differentiable; see `msb.methods.three_dgs.reference`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training.composite import composite
from data_stubs.training.drawing import Drawn, as_float64, per_pair_dtype, picture
from data_stubs.training.geometry import colors_from_sh, rotate, to_samples, transform
from data_stubs.training.pair_functions import Affine, GaussianAlpha, Spread
from data_stubs.training.pairs import front_to_back, make_pairs
from msb.methods.three_dgs.reference import DILATION, FAR, MAX_ALPHA, NEAR, NEAREST
from msb.reference.camera_matrices import splatting_camera

if TYPE_CHECKING:
    from data_stubs.training.drawing import Parameters
    from data_stubs.training.pairs import Pairs
    from msb.reference.camera_matrices import SplattingCamera
    from msb.scenes import Camera

# Half-planes that contain everything: the pixels of a Gaussian are only limited by its box.
EVERYWHERE = np.tile([0.0, 0.0, 1.0], (3, 1))
LEAST_ALPHA = 1 / 255


def draw(
    parameters: Parameters,
    camera: Camera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
) -> Drawn:
    """Return the image of `parameters` (as in the official file) from `camera`.

    `settings` has `sh_degree`. Gaussians are not cut off at three standard deviations.
    """
    view = splatting_camera(camera, NEAR, FAR, np.float64)
    opacity = parameters["opacity"][:, 0].double().sigmoid()
    mean = parameters["xyz"].double()
    with torch.no_grad():
        depth = as_float64(transform(view.world_to_camera[:3], mean)[:, 2])
        kept = (depth > NEAREST["official"]) & (as_float64(opacity) > LEAST_ALPHA)
    order = front_to_back(depth, kept)
    # Everything is computed for Gaussians in front of the camera, in drawing order.
    inside = torch.from_numpy(order)
    mean, opacity = mean[inside], opacity[inside]
    center = to_samples(mean, view)
    xx, xy, yy = project_covariances(parameters, inside, view)
    with torch.no_grad():
        reach = torch.sqrt(2 * torch.log(255 * opacity))[:, None] * torch.stack([xx, yy], 1).sqrt()
        size = np.array([view.width, view.height])
        first = np.clip(np.floor(as_float64(center - reach)), 0, size).astype(np.int64)
        last = np.clip(np.ceil(as_float64(center + reach)), -1, size - 1).astype(np.int64)
    box = np.zeros((2, len(depth), 2), np.int64)
    box[0, order], box[1, order] = first, last
    planes = np.broadcast_to(EVERYWHERE, (len(depth), 3, 3))
    pairs = make_pairs(order, planes, (box[0], box[1]), view.width, view.height, per_pair_dtype(parameters))
    # Places of the Gaussians with pairs in the arrays in drawing order.
    place = np.zeros(len(depth), np.int64)
    place[order] = np.arange(len(order))
    seen = torch.from_numpy(place[pairs.faces])
    rows = _whitening_rows(center[seen], xx[seen], xy[seen], yy[seen])
    u, v = Affine.apply(rows, pairs).unbind(0)
    eccentricity = (u * u + v * v + 1e-12).sqrt()
    return blend(parameters, pairs, eccentricity, opacity[seen], mean[seen], view, background, settings)


def blend(
    parameters: Parameters,
    pairs: Pairs,
    eccentricity: torch.Tensor,
    opacity: torch.Tensor,
    mean: torch.Tensor,
    view: SplattingCamera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
) -> Drawn:
    """Return the image of blended Gaussians or discs, from the pairs of a Gaussian and a pixel.

    `eccentricity` has the distance of each pair from the centre, in standard deviations. `opacity` and `mean`
    have one row for each entry of `pairs.faces`.
    """
    alpha = GaussianAlpha.apply(eccentricity, Spread.apply(opacity, pairs), 1, MAX_ALPHA)
    alpha = alpha * (alpha.detach() >= LEAST_ALPHA)  # skipped pairs have no gradient
    faces = torch.from_numpy(pairs.faces)
    coefficients = torch.cat([parameters["f_dc"], parameters["f_rest"]], 1)[faces].double()
    color = colors_from_sh(coefficients, mean, view.center, settings["sh_degree"])
    blended = composite(alpha, color.T, pairs, blends_crossing=False)
    image = picture(blended.color, blended.transmittance, background, view.width, view.height)
    return Drawn(image, pairs, blended.weight)


def project_covariances(
    parameters: Parameters, faces: torch.Tensor, view: SplattingCamera
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the entries xx, xy and yy (n,) of the covariances of `faces` (n,) on the screen, dilated."""
    x, y, z = transform(view.world_to_camera[:3], parameters["xyz"][faces].double()).unbind(-1)
    tangent = [1.3 * float(value) for value in view.tan_fov]
    focal = [
        size / (2 * float(value)) for size, value in zip((view.width, view.height), view.tan_fov, strict=True)
    ]
    x, y = ((p / z).clamp(-limit, limit) for p, limit in zip((x, y), tangent, strict=True))
    # The columns of the rotation times the deviations, in the camera: (n, 3 axes, 3).
    deviation = parameters["scale"][faces].double().exp()
    axes = rotation_matrices(parameters["rotation"][faces].double()).transpose(1, 2) * deviation[..., None]
    across, down, ahead = rotate(view.world_to_camera, axes).unbind(-1)
    p = (across - x[:, None] * ahead) * (focal[0] / z)[:, None]
    q = (down - y[:, None] * ahead) * (focal[1] / z)[:, None]
    return (p * p).sum(1) + DILATION, (p * q).sum(1), (q * q).sum(1) + DILATION


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:
    """Return the rotations (n, 3, 3) of quaternions w, x, y, z (n, 4) of any length."""
    w, x, y, z = (quaternions / quaternions.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _whitening_rows(
    center: torch.Tensor, xx: torch.Tensor, xy: torch.Tensor, yy: torch.Tensor
) -> torch.Tensor:
    """Return rows (n, 2, 3): their values at (x, y, 1) have the square sum d^T C^-1 d, d from the centre."""
    across = xx.rsqrt()
    down = (yy - xy * xy / xx).rsqrt()
    slope = -down * xy / xx
    zero = torch.zeros_like(across)
    first = torch.stack([across, zero, -across * center[:, 0]], -1)
    second = torch.stack([slope, down, -slope * center[:, 0] - down * center[:, 1]], -1)
    return torch.stack([first, second], 1)
