"""MeshSplatting's image formation, differentiable; see `msb.methods.mesh_splatting.reference`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training.composite import composite
from data_stubs.training.drawing import Drawn, as_float64, per_pair_dtype, picture
from data_stubs.training.geometry import barycentric_rows, colors_from_sh, edge_distances, to_samples
from data_stubs.training.pair_functions import Affine, Highest, Spread, WindowAlpha
from data_stubs.training.pairs import front_to_back, make_pairs, tile_box
from data_stubs.training.triangle_splatting import window_planes
from msb.methods.mesh_splatting.reference import MAX_ALPHA, corner_tiles
from msb.reference.camera_matrices import splatting_camera
from msb.reference.edge_window import FAR, MIN_OPACITY, NEAR, project_windows

if TYPE_CHECKING:
    from data_stubs.training.drawing import Parameters
    from msb.scenes import Camera


def draw(
    parameters: Parameters,
    indices: NDArray[np.int64],
    camera: Camera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
) -> Drawn:
    """Return the image of `parameters` (as in the official file) from `camera`.

    `settings` has `sh_degree`, `supersample`, `opacity_floor` and `sigma`.
    """
    scale, floor = settings["supersample"], settings["opacity_floor"]
    view = splatting_camera(camera, NEAR, FAR, np.float64, scale)
    vertex_opacity = floor + (1 - floor) * parameters["vertex_weight"][:, 0].double().sigmoid()
    corner = torch.from_numpy(indices)
    opacity = vertex_opacity[corner].amin(1)
    positions = parameters["triangles_points"].double()
    with np.errstate(all="ignore"):
        windows = project_windows(as_float64(positions)[indices], view)
        o = as_float64(opacity)
        sigma = np.full(len(o), settings["sigma"])
        rectangles = corner_tiles(windows, o, sigma, view)
        kept = ~(windows.dropped | (o < MIN_OPACITY) | rectangles.empty)
        planes = window_planes(windows, o, sigma)
    order = front_to_back(windows.depth, kept)
    box = tile_box(rectangles, view.width, view.height)
    pairs = make_pairs(order, planes, box, view.width, view.height, per_pair_dtype(parameters))
    seen, local = np.unique(indices[pairs.faces], return_inverse=True)
    vertices, corner = torch.from_numpy(seen), torch.from_numpy(local.reshape(-1, 3))
    places = positions[vertices]
    screen = to_samples(places, view)[corner]
    rows, inradius = edge_distances(screen)
    phi = Highest.apply(Affine.apply(rows, pairs)) * Spread.apply(1 / inradius, pairs)
    opacities = Spread.apply(opacity[torch.from_numpy(pairs.faces)], pairs)
    sigma = torch.tensor(settings["sigma"], dtype=phi.dtype)
    alpha = WindowAlpha.apply(phi, opacities, sigma, MAX_ALPHA)
    coefficients = torch.cat([parameters["features_dc"], parameters["features_rest"]], 1)[vertices].double()
    color = colors_from_sh(coefficients, places, view.center, settings["sh_degree"])[corner]
    color_rows = torch.einsum("gkc,gkr->gcr", color, barycentric_rows(screen))
    blended = composite(alpha, Affine.apply(color_rows, pairs), pairs, blends_crossing=False)
    image = picture(blended.color, blended.transmittance, background, view.width, view.height)
    size = (camera.height, scale, camera.width, scale, 3)
    return Drawn(image.reshape(size).mean((1, 3)), pairs, blended.weight, scale)
