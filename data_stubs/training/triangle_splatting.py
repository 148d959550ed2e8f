"""Triangle-Splatting's image formation, differentiable; see `msb.methods.triangle_splatting.reference`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training.composite import composite
from data_stubs.training.drawing import Drawn, as_float64, per_pair_dtype, picture
from data_stubs.training.geometry import centroid, colors_from_sh, edge_distances, to_samples
from data_stubs.training.pair_functions import Affine, Highest, Spread, WindowAlpha
from data_stubs.training.pairs import front_to_back, make_pairs, tile_box
from msb.methods.triangle_splatting.reference import MAX_ALPHA, contour_tiles
from msb.reference.camera_matrices import splatting_camera
from msb.reference.edge_window import FAR, MIN_OPACITY, NEAR, project_windows

if TYPE_CHECKING:
    from data_stubs.training.drawing import Parameters
    from msb.reference.edge_window import Windows
    from msb.scenes import Camera

SIGMA_OFFSET = 0.01


def draw(
    parameters: Parameters,
    camera: Camera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
) -> Drawn:
    """Return the image of `parameters` (as in the official file) from `camera`.

    `settings` has `sh_degree` and `view_dir`.
    """
    view = splatting_camera(camera, NEAR, FAR, np.float64)
    opacity = parameters["opacity"][:, 0].double().sigmoid()
    sigma = SIGMA_OFFSET + parameters["sigma"][:, 0].double().exp()
    with np.errstate(all="ignore"):
        windows = project_windows(as_float64(parameters["triangles_points"]), view)
        o, s = as_float64(opacity), as_float64(sigma)
        rectangles = contour_tiles(windows, o, s, view)
        kept = ~(windows.dropped | (o < MIN_OPACITY) | rectangles.empty)
        planes = window_planes(windows, o, s)
    order = front_to_back(windows.depth, kept)
    box = tile_box(rectangles, view.width, view.height)
    pairs = make_pairs(order, planes, box, view.width, view.height, per_pair_dtype(parameters))
    faces = torch.from_numpy(pairs.faces)
    points = parameters["triangles_points"][faces].double()
    rows, inradius = edge_distances(to_samples(points, view))
    phi = Highest.apply(Affine.apply(rows, pairs)) * Spread.apply(1 / inradius, pairs)
    opacities, sigmas = Spread.apply(opacity[faces], pairs), Spread.apply(sigma[faces], pairs)
    alpha = WindowAlpha.apply(phi, opacities, sigmas, MAX_ALPHA)
    seen = centroid(points)
    if settings["view_dir"] == "broadcast_z":
        seen = seen[:, 2:].expand(-1, 3)
    coefficients = torch.cat([parameters["features_dc"], parameters["features_rest"]], 1)[faces].double()
    color = colors_from_sh(coefficients, seen, view.center, settings["sh_degree"])
    blended = composite(alpha, color.T, pairs, blends_crossing=False)
    image = picture(blended.color, blended.transmittance, background, view.width, view.height)
    return Drawn(image, pairs, blended.weight)


def window_planes(
    windows: Windows, opacity: NDArray[np.float64], sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return half-planes (F, 3, 3) for `make_pairs` that contain all samples with alpha of at least 1/255."""
    phi = (1 / (255 * np.maximum(opacity, 1 / 255))) ** (1 / sigma) * (1 - 1e-6)
    offset = windows.edge_offset - (phi * windows.inradius[:, 2])[:, None]
    return -np.concatenate([windows.edge_normal, offset[..., None]], axis=2)
