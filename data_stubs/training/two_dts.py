"""2DTS' image formation, both rasterizers, differentiable; see `msb.methods.two_dts.reference`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training.composite import composite
from data_stubs.training.drawing import Drawn, as_float64, per_pair_dtype, picture
from data_stubs.training.geometry import (
    barycentric_rows,
    centroid,
    colors_from_sh,
    ndc_to_pixel,
    norm,
    rotate,
    transform,
)
from data_stubs.training.pair_functions import Affine, GaussianAlpha, Highest, Quotient, Spread
from data_stubs.training.pairs import front_to_back, make_pairs, tile_box
from msb.methods.two_dts.reference import (
    EPS,
    FAR,
    MAX_ALPHA,
    NEAR,
    AffineRasterizer,
    PlanarRasterizer,
    reach,
    rescale,
)
from msb.reference.camera_matrices import splatting_camera

if TYPE_CHECKING:
    from data_stubs.training.drawing import Parameters
    from msb.reference.camera_matrices import SplattingCamera
    from msb.scenes import Camera


def draw(
    parameters: Parameters,
    camera: Camera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
) -> Drawn:
    """Return the image of `parameters` (as in the official file) from `camera`.

    `settings` has all settings of the method.
    """
    scale, gamma = settings["render_up_scale"] or 1, float(settings["gamma"])
    view = splatting_camera(camera, NEAR, FAR, np.float64, scale)
    opacity = _opacity(parameters["_opacity"][:, 0].double(), settings["ste_threshold"])
    stored = as_float64(parameters["_vertex"])
    with np.errstate(all="ignore"):
        vertices = rescale(stored, gamma) if settings["gamma_rescale"] else stored
        official = AffineRasterizer if settings["rasterizer"] == "2D" else PlanarRasterizer
        raster = official(vertices, view, settings["back_culling"])
        rows = _ROWS[settings["rasterizer"]](torch.from_numpy(vertices), view).numpy()
        # A sample is inside if a_k >= (1 - reach) / 3 for all coordinates a_k = l_k / (l_0 + l_1 + l_2).
        least = (1 - reach(as_float64(opacity), gamma)) / 3 - 1e-6
        planes = rows - least[:, None, None] * rows.sum(axis=1, keepdims=True)
    order = front_to_back(raster.depth, ~raster.dropped)
    box = tile_box(raster.rectangles, view.width, view.height)
    pairs = make_pairs(order, planes, box, view.width, view.height, per_pair_dtype(parameters))
    faces = torch.from_numpy(pairs.faces)
    corners = parameters["_vertex"][faces].double()
    if settings["gamma_rescale"]:
        middle = centroid(corners)[:, None]
        corners = (corners - middle) * _shrinking(gamma) + middle
    lines = Affine.apply(_ROWS[settings["rasterizer"]](corners, view), pairs)
    if settings["rasterizer"] == "3D":
        lines = Quotient.apply(lines, EPS)
    eccentricity = Highest.apply(1 - 3 * lines)
    alpha = GaussianAlpha.apply(eccentricity, Spread.apply(opacity[faces], pairs), gamma, MAX_ALPHA)
    coefficients = torch.cat([parameters["_f_dc"], parameters["_f_rest"]], 1)[faces].double()
    color = colors_from_sh(coefficients, centroid(corners), view.center, settings["sh_degree"])
    blended = composite(alpha, color.T, pairs, blends_crossing=True)
    image = picture(blended.color, blended.transmittance, background, view.width, view.height)
    return Drawn(_shrunk(image, scale), pairs, blended.weight, scale)


def _opacity(logit: torch.Tensor, threshold: float | None) -> torch.Tensor:
    """Return the opacity, or, as a straight-through estimator, 0 or 1 with the derivative of the opacity."""
    opacity = logit.sigmoid()
    if threshold is None:
        return opacity
    step = (opacity > threshold).double()
    return (step - opacity).detach() + opacity


def _shrinking(gamma: float) -> float:
    beta = 1 / gamma
    return 1 / math.sqrt(2**beta * beta * math.gamma(beta))


def _affine_rows(vertices: torch.Tensor, view: SplattingCamera) -> torch.Tensor:
    """Return the "2D" rasterizer's barycentric coordinates of triangles (G, 3, 3) on the screen."""
    center = centroid(vertices)
    h = transform(view.full_projection, center)
    ndc = h[:, :2] * (1 / (h[:, 3:].abs() + EPS))
    camera = transform(view.world_to_camera[:3], center)
    tan_fov, shift = torch.from_numpy(view.tan_fov), torch.from_numpy(view.shift)
    limit = 1.3 * tan_fov * camera[:, 2:]
    clamped = torch.minimum(torch.maximum(-limit, camera[:, :2]), limit)
    arms = rotate(view.world_to_camera, vertices - center[:, None])
    z = camera[:, None, 2:]
    flat = (arms[..., :2] - arms[..., 2:] * clamped[:, None] / z) / (z * tan_fov)
    size = torch.tensor([view.width, view.height], dtype=torch.float64)
    flat = flat * (0.5 * size + 0.5 / norm(flat)[..., None])
    middle = torch.stack([ndc_to_pixel(ndc[:, 0], view.width), ndc_to_pixel(ndc[:, 1], view.height)], 1)
    return barycentric_rows((middle + shift)[:, None] + flat)


def _planar_rows(vertices: torch.Tensor, view: SplattingCamera) -> torch.Tensor:
    """Return rows; divided by their sum, they are the barycentric coordinates where rays meet triangles.

    A sample's ray g meets the plane of V_0, V_1 and V_2 at barycentric coordinates g . (V_1 x V_2), g . (V_2
    x V_0) and g . (V_0 x V_1), divided by their sum. Signs are chosen so that the sum is positive where the
    plane is in front of the camera.
    """
    first, second, third = transform(view.world_to_camera[:3], vertices).unbind(1)
    normals = torch.stack(
        [torch.cross(a, b, dim=1) for a, b in ((second, third), (third, first), (first, second))], 1
    )
    facing = torch.sign((first * normals[:, 0]).sum(1).detach())
    normals = normals * facing[:, None, None]
    (tan_x, tan_y), (shift_x, shift_y) = view.tan_fov.tolist(), view.shift.tolist()
    x, y, z = normals.unbind(-1)
    constant = x * (tan_x * (1 - view.width - 2 * shift_x) / view.width) + z
    constant = constant + y * (tan_y * (1 - view.height - 2 * shift_y) / view.height)
    return torch.stack([x * (2 * tan_x / view.width), y * (2 * tan_y / view.height), constant], -1)


_ROWS = {"2D": _affine_rows, "3D": _planar_rows}


def _shrunk(image: torch.Tensor, scale: int) -> torch.Tensor:
    """Return (s H, s W, 3) as (H, W, 3), as `msb.methods.two_dts.reference.resize`."""
    if scale == 1:
        return image
    first, second = (scale - 1) // 2, scale // 2
    parts = [image[i::scale, j::scale] for i in (first, second) for j in (first, second)]
    return (parts[0] + parts[1] + parts[2] + parts[3]) / 4
