"""MeshSplatting: an indexed mesh with vertex colours and opacities, rendered with supersampling.

Sources: meshsplatting/mesh-splatting at 608e5d0: scene/triangle_model.py (activations),
triangle_renderer/__init__.py (supersampling); meshsplatting/diff-triangle-mesh-rasterization at b27f283:
cuda_rasterizer/forward.cu.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.reference.arithmetic import Reals, transform
from msb.reference.blend import Layers, Rule, composite, expected_depth
from msb.reference.camera_matrices import SplattingCamera, splatting_camera
from msb.reference.edge_window import FAR, MIN_OPACITY, NEAR, Windows, project_shapes, window_alpha
from msb.reference.frame import ReferenceFrame
from msb.reference.parameters import opacities, sh_coefficients
from msb.reference.sh import colors_from_sh
from msb.reference.tiles import TILE, Integers, Modes, Rectangles, grid_size, tile_number
from msb.scenes import Camera

# A function that returns the tiles of each face from the windows, opacities, sigma and the view.
TilesOf = Callable[[Windows, Reals, Reals, SplattingCamera], Rectangles]
# Upper limit of alpha.
MAX_ALPHA = 0.999
# The tiles of a face extend beyond its corners by this many samples.
MARGIN = 5
_RULE = Rule(blends_crossing=False, weight_first=False)


def corner_tiles(windows: Windows, opacity: Reals, sigma: Reals, view: SplattingCamera) -> Rectangles:
    """Return the tiles of the box around the corners, widened by 5 samples on each side."""
    margin = windows.corners.dtype.type(MARGIN)
    grid = grid_size(view.width, view.height)
    low = tile_number(np.floor((windows.corners - margin) / TILE), grid).min(axis=1)
    high = tile_number(np.ceil((windows.corners + margin) / TILE), grid).max(axis=1)
    return Rectangles(low, high)


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
    *,
    max_alpha: float = MAX_ALPHA,
    flat_depth: bool = False,
    tiles_of: TilesOf = corner_tiles,
) -> ReferenceFrame:
    """Return the frame of `asset` from `camera`; see `render_reference`. The default values are for
    MeshSplatting.

    `max_alpha` limits alpha. If `flat_depth` is true, the whole face has the depth of its centroid. If
    `flat_depth` is false, the depth is interpolated between the corners. The function `tiles_of` returns the
    tiles of faces.
    """
    samples = settings["supersample"]
    view = splatting_camera(camera, NEAR, FAR, dtype, samples)
    positions = asset.buffers["positions"].astype(dtype)
    indices = asset.buffers["indices"]
    vertices = len(positions)
    # Activated parameters. The opacity of a face is the least opacity of its vertices; colours and depths are
    # per corner.
    floor = settings["opacity_floor"]
    opacity = dtype(floor) + dtype(1 - floor) * opacities(asset, vertices, dtype)
    opacity = opacity[indices].min(axis=1)
    sigma = np.full(len(indices), settings["sigma"], dtype)
    coefficients = sh_coefficients(asset, vertices, dtype)
    color = colors_from_sh(coefficients, positions, view.center, settings["sh_degree"])[indices]
    depth = transform(view.world_to_camera[:3], positions)[:, 2][indices]
    # Project the faces. Cull faces by shape, by opacity, and by empty tile rectangles.
    shapes = project_shapes(positions[indices], view, modes)
    if isinstance(shapes, Windows):
        rectangles = tiles_of(shapes, opacity, sigma, view)
    else:
        rectangles = shapes.rectangles
    kept = ~(shapes.dropped | (opacity < dtype(MIN_OPACITY)) | rectangles.empty)

    def cover(chosen: Integers, x: Reals, y: Reals) -> Reals:
        return window_alpha(shapes.phi(chosen, x, y), opacity[chosen], sigma[chosen], max_alpha)

    def shade(chosen: Integers, x: Reals, y: Reals) -> Layers:
        b0, b1, b2 = shapes.barycentrics(chosen, x, y)
        c, z = color[chosen], depth[chosen]
        if flat_depth:
            here = shapes.depth_at(chosen, x, y)
        else:
            here = b0 * z[:, 0] + b1 * z[:, 1] + b2 * z[:, 2]
        return Layers(
            b0[:, None] * c[:, 0] + b1[:, None] * c[:, 1] + b2[:, None] * c[:, 2],
            here,
            shapes.normal[chosen],
        )

    # Blend all samples, then average the samples of each pixel.
    tiles = modes.tiles(rectangles, shapes.depth, kept, view)
    weights = np.zeros(len(kept))
    blended = composite(tiles, cover, shade, _RULE, view.width, view.height, dtype, weights)
    raster = blended.over(background)
    alpha = box_mean(blended.alpha, samples)
    middle = samples // 2
    name = f"ss{samples}_"
    return ReferenceFrame(
        image=box_mean(raster, samples),
        alpha=alpha,
        depth=expected_depth(box_mean(blended.depth, samples), alpha),
        depth_median=box_mean(blended.depth_median, samples),
        normal=box_mean(blended.normal, samples),
        face_id=blended.face_median[middle::samples, middle::samples],
        visible=kept,
        contribution=weights,
        raw={
            f"{name}image": raster,
            f"{name}alpha": blended.alpha,
            f"{name}depth_expected": blended.depth,
            f"{name}depth_median": blended.depth_median,
            f"{name}normal_cam": blended.normal,
            f"{name}face_id": blended.face_median,
            f"faces_kept_ss{samples}": int(kept.sum()),
            "radii": np.where(kept, np.ceil(shapes.radius), 0).astype(np.int32),
        },
    )


def box_mean(raster: Reals, size: int) -> Reals:
    """Return the means of blocks of size x size samples, as an array (H, W, ...)."""
    total = np.zeros_like(raster[::size, ::size])
    for row in range(size):
        for column in range(size):
            total = total + raster[row::size, column::size]
    return np.asarray(total / size**2)
