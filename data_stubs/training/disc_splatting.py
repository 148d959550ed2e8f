"""2DGS' image formation, differentiable; see `msb.methods.two_dgs.reference`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training.drawing import Drawn, as_float64, per_pair_dtype
from data_stubs.training.gaussian_splatting import EVERYWHERE, LEAST_ALPHA, blend, rotation_matrices
from data_stubs.training.geometry import rows_of, transform
from data_stubs.training.pair_functions import Affine
from data_stubs.training.pairs import front_to_back, make_pairs
from msb.methods.three_dgs.reference import FAR, MAX_EXTENT, NEAR, NEAREST
from msb.methods.two_dgs.reference import CUTOFF, FILTER, find_box
from msb.reference.camera_matrices import splatting_camera

if TYPE_CHECKING:
    from data_stubs.training.drawing import Parameters
    from msb.reference.camera_matrices import SplattingCamera
    from msb.scenes import Camera

_LEAST_DIVISOR = 1e-9
"""A ray misses a disc if the divisor of u and v is smaller. Its unit is square samples times a depth."""


def draw(
    parameters: Parameters,
    camera: Camera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
) -> Drawn:
    """Return the image of `parameters` (as in the official file) from `camera`.

    `settings` has `sh_degree`. Discs are not cut off at three standard deviations. Discs that reach behind
    the camera are left out.
    """
    view = splatting_camera(camera, NEAR, FAR, np.float64)
    mean, opacity = parameters["xyz"].double(), parameters["opacity"][:, 0].double().sigmoid()
    tu, tv, tw = _homography(parameters, view)
    with torch.no_grad():
        depth = as_float64(transform(view.world_to_camera[:3], mean)[:, 2])
        middle, extent, is_valid = find_box(as_float64(tu), as_float64(tv), as_float64(tw), MAX_EXTENT)
        reach = np.maximum(extent, MAX_EXTENT * FILTER)
        behind = MAX_EXTENT * np.hypot(*as_float64(tw)[:, :2].T) >= depth
        kept = (depth > NEAREST["official"]) & (as_float64(opacity) > LEAST_ALPHA) & is_valid & ~behind
    order = front_to_back(depth, kept)
    # First and last samples of each disc, and the pairs inside these boxes.
    size = np.array([view.width, view.height])
    box = np.zeros((2, len(depth), 2), np.int64)
    box[0, order] = np.clip(np.floor(middle - reach)[order], 0, size)
    box[1, order] = np.clip(np.ceil(middle + reach)[order], -1, size - 1)
    planes = np.broadcast_to(EVERYWHERE, (len(depth), 3, 3))
    pairs = make_pairs(order, planes, (box[0], box[1]), view.width, view.height, per_pair_dtype(parameters))
    faces = torch.from_numpy(pairs.faces)
    # The ray of a sample meets a disc at u, v: quotients of functions that are affine on the screen.
    u, v, divisor, x, y = Affine.apply(_rows(tu[faces], tv[faces], tw[faces]), pairs).unbind(0)
    is_met = divisor.abs() > _LEAST_DIVISOR
    inverse = 1 / divisor.where(is_met, torch.ones_like(divisor))
    square = ((u * inverse).square() + (v * inverse).square()).where(is_met, torch.full_like(u, np.inf))
    nearest = torch.minimum(square, 2 * (x * x + y * y))
    eccentricity = (nearest + 1e-12).sqrt()
    return blend(parameters, pairs, eccentricity, opacity[faces], mean[faces], view, background, settings)


def _homography(
    parameters: Parameters, view: SplattingCamera
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return Tu, Tv, Tw (n, 3): times (u, v, 1) they are x depth, y depth and depth, x and y in samples."""
    axes = rotation_matrices(parameters["rotation"].double())[:, :, :2]
    axes = axes * parameters["scale"].double().exp()[:, None, :]
    columns = torch.cat([axes, parameters["xyz"].double()[..., None]], 2)
    rows = []
    for row in (0, 1, 3):
        a, b, c, d = rows_of(view.full_projection)[row]
        product = a * columns[:, 0] + b * columns[:, 1] + c * columns[:, 2]
        rows.append(product + product.new_tensor([0, 0, d]))
    x, y, w = rows
    half_x, half_y = view.width / 2, view.height / 2
    shift_x, shift_y = (float(shift) - 0.5 for shift in view.shift)
    return x * half_x + w * (half_x + shift_x), y * half_y + w * (half_y + shift_y), w


def _rows(tu: torch.Tensor, tv: torch.Tensor, tw: torch.Tensor) -> torch.Tensor:
    """Return rows (n, 5, 3), whose values at (x, y, 1) are u d, v d, d, and the offset from the centre.

    The cross product of x Tw - Tu and y Tw - Tv has no term in x y, so it is affine.
    """
    cross = torch.linalg.cross
    product = torch.stack([cross(tv, tw), cross(tw, tu), cross(tu, tv)], -1)
    # The centre of the official box.
    weight = tw.new_tensor([CUTOFF["official"] ** 2, CUTOFF["official"] ** 2, -1])
    weight = weight / (weight * tw * tw).sum(1, keepdim=True)
    center = torch.stack([(weight * tu * tw).sum(1), (weight * tv * tw).sum(1)], 1)
    unit = torch.eye(2, dtype=tw.dtype).expand(len(tw), 2, 2)
    return torch.cat([product, torch.cat([unit, -center[..., None]], 2)], 1)
