"""Triangle-Splatting: a triangle soup with a window that falls off from the incentre to the edges.

Sources: trianglesplatting/triangle-splatting at 685ff27: scene/triangle_model.py (activations),
triangle_renderer/__init__.py; trianglesplatting/diff-triangle-rasterization at 6d61f4c:
cuda_rasterizer/forward.cu.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.asset.drawable import require, required_buffer
from msb.reference.arithmetic import Reals, centroid, exponential, fast_power, norm
from msb.reference.blend import Layers, Rule, composite, expected_depth
from msb.reference.camera_matrices import SplattingCamera, splatting_camera
from msb.reference.edge_window import FAR, MIN_OPACITY, NEAR, Windows, project_shapes, window_alpha
from msb.reference.frame import ReferenceFrame
from msb.reference.parameters import number, opacities, sh_coefficients, triangles
from msb.reference.sh import colors_from_sh
from msb.reference.tiles import TILE, Integers, Modes, Rectangles, grid_size, tile_number
from msb.scenes import Camera

# Upper limit of alpha.
MAX_ALPHA = 0.99
# Two edges with a smaller determinant of their normals are treated as parallel.
MIN_DETERMINANT = 1e-3
_RULE = Rule(blends_crossing=False, weight_first=False)


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
) -> ReferenceFrame:
    """Return the frame of `asset` from `camera`; see `render_reference`."""
    view = splatting_camera(camera, NEAR, FAR, dtype)
    vertices = triangles(asset, dtype)
    faces = len(vertices)
    opacity = opacities(asset, faces, dtype)
    require(asset, "coverage", "sigma_encoding", "exp")
    offset = dtype(number(asset, "coverage", "sigma_offset"))
    sigma = offset + exponential(required_buffer(asset, "sigma", faces).astype(dtype))
    color = colors_from_sh(
        sh_coefficients(asset, faces, dtype),
        points_seen(vertices, settings["view_dir"]),
        view.center,
        settings["sh_degree"],
    )
    shapes = project_shapes(vertices, view, modes)
    rectangles = (
        contour_tiles(shapes, opacity, sigma, view) if isinstance(shapes, Windows) else shapes.rectangles
    )
    kept = ~(shapes.dropped | (opacity < dtype(MIN_OPACITY)) | rectangles.empty)

    def cover(chosen: Integers, x: Reals, y: Reals) -> Reals:
        return window_alpha(shapes.phi(chosen, x, y), opacity[chosen], sigma[chosen], MAX_ALPHA)

    def shade(chosen: Integers, x: Reals, y: Reals) -> Layers:
        return Layers(color[chosen], shapes.depth_at(chosen, x, y), shapes.normal[chosen])

    tiles = modes.tiles(rectangles, shapes.depth, kept, view)
    weights = np.zeros(len(kept))
    blended = composite(tiles, cover, shade, _RULE, view.width, view.height, dtype, weights)
    return ReferenceFrame(
        image=blended.over(background),
        alpha=blended.alpha,
        depth=expected_depth(blended.depth, blended.alpha),
        depth_median=blended.depth_median,
        normal=blended.normal,
        face_id=None,
        visible=kept,
        contribution=weights,
        raw={
            "alpha": blended.alpha,
            "depth_accum": blended.depth,
            "depth_median": blended.depth_median,
            "normal_accum": blended.normal,
            "radii": np.where(kept, np.ceil(shapes.radius), 0).astype(np.int32),
            "full_projection": view.full_projection,
            "camera_center": view.center,
        },
    )


def points_seen(vertices: Reals, view_dir: str) -> Reals:
    """Return the points (F, 3) that define the view directions of triangles (F, 3 corners, 3).

    "broadcast_z" returns (g_z, g_z, g_z), where g_z is the world z of the centroid. The official kernel was
    meant to use the centroid. Because of an error in an expression, the kernel uses the centroid's z for x, y
    and z. Models are trained with this error, so their coefficients need the same direction.
    """
    center = centroid(vertices)
    return np.repeat(center[:, 2:], 3, axis=1) if view_dir == "broadcast_z" else center


def contour_tiles(windows: Windows, opacity: Reals, sigma: Reals, view: SplattingCamera) -> Rectangles:
    """Return the tiles of the contour o phi^sigma = 0.01: edges are moved inwards and then intersected.

    Samples beyond the contour, down to alpha = 1/255, are visible only in tiles that the contour touches.
    """
    real = opacity.dtype.type
    edge_normal, edge_offset = windows.edge_normal, windows.edge_offset
    shrunk = fast_power(real(MIN_OPACITY) / opacity, 1 / sigma)
    offset = edge_offset / norm(edge_normal)
    distance = np.zeros_like(opacity)
    for edge in range(3):
        # All three edges are moved by the distance of one edge, unless that distance underflowed to 0.
        distance = np.where(distance == 0, windows.inradius[:, edge] * shrunk, distance)
        offset[:, edge] = offset[:, edge] - distance
    grid = grid_size(view.width, view.height)
    low, high = np.tile(grid, (len(opacity), 1)), np.zeros((len(opacity), 2), np.int64)
    # Intersect each pair of moved edges, and extend the box of tiles by the intersection.
    for current, previous in ((1, 0), (2, 1), (0, 2)):
        n, m = edge_normal[:, current], edge_normal[:, previous]
        t, s = offset[:, current], offset[:, previous]
        determinant = n[:, 0] * m[:, 1] - n[:, 1] * m[:, 0]
        x = -(t * m[:, 1] - s * n[:, 1]) / determinant
        y = -(s * n[:, 0] - t * m[:, 0]) / determinant
        corner = np.stack([x, y], axis=-1)
        # The official test compares with a double-precision number. The comparison of the last pair of edges
        # is reversed, so a NaN skips this pair.
        size = np.abs(determinant).astype(np.float64)
        skipped = ~(size > MIN_DETERMINANT) if current == 0 else size < MIN_DETERMINANT
        use = ~skipped[:, None]
        low = np.where(use, np.minimum(low, tile_number(corner / TILE, grid)), low)
        high = np.where(use, np.maximum(high, tile_number((corner + TILE - 1) / TILE, grid)), high)
    return Rectangles(low, high)
