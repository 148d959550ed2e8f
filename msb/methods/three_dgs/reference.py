"""Renders 3DGS in the official order of operations, or by the rules of gsplat.

Sources: graphdeco-inria/diff-gaussian-rasterization at 59f5f77: cuda_rasterizer/forward.cu, auxiliary.h; for
antialiased models its branch dr_aa; nerfstudio-project/gsplat at 90d7b4b: gsplat/cuda/_torch_impl.py.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.reference.arithmetic import Reals, exponential, ndc_to_pixel, transform
from msb.reference.blend import Layers, Rule, composite, expected_depth
from msb.reference.camera_matrices import SplattingCamera, splatting_camera
from msb.reference.frame import ReferenceFrame
from msb.reference.parameters import sh_coefficients
from msb.reference.sh import colors_from_sh
from msb.reference.tiles import TILE, Integers, Modes, Rectangles, grid_size, tile_number
from msb.scenes import Camera
from msb.splats.primitive import activate, covariances

# Near and far planes of the official projection matrix.
NEAR, FAR = 0.01, 100.0
# Means at this depth or nearer are dropped; the value depends on the rasterizer.
NEAREST = {"official": 0.2, "gsplat": 0.01}
# Variance, in square samples, that is added to both axes on the screen.
DILATION = 0.3
MAX_ALPHA = 0.99
# Minimum ratio of the determinants with and without dilation, for antialiased models.
MIN_COMPENSATION = 0.000025
# Maximum extent of a Gaussian in standard deviations, by the rules of gsplat.
MAX_EXTENT = 3.33
# Lower limit of the term under the square root in the official radius.
MIN_SQUARE = 0.1
_RULE = Rule(blends_crossing=False, weight_first=False)


class Projected(NamedTuple):
    """A set of `N` Gaussians on the screen.

    Attributes
    ----------
    center : (N, 2)
        Positions in samples, with sample centres at integers.
    covariance, sharp : (N, 3)
        Screen covariances xx, xy and yy in square samples, with and without the dilation.
    with_depth : (N, 2)
        Covariances of x and y with the depth.
    """

    center: Reals
    covariance: Reals
    sharp: Reals
    with_depth: Reals


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
) -> ReferenceFrame:
    """Return the frame of `asset` from `camera`; see `render_reference`.

    The depth of a Gaussian at a sample is the conditional mean of z at this sample. The conditional mean
    differs from the depth of the Gaussian's centre.
    """
    real, rasterizer = dtype, settings["rasterizer"]
    view = splatting_camera(camera, NEAR, FAR, dtype)
    gaussians = activate(asset, 3, dtype)
    count, mean, opacity = len(gaussians.mean), gaussians.mean, gaussians.opacity
    color = colors_from_sh(sh_coefficients(asset, count, dtype), mean, view.center, settings["sh_degree"])
    point = transform(view.world_to_camera[:3], mean)
    z, nearest = point[:, 2], real(NEAREST[rasterizer])
    shapes = _project(covariances(gaussians.deviation, gaussians.rotation), mean, point, view, rasterizer)
    xx, xy, yy = shapes.covariance.T
    determinant = xx * yy - xy * xy
    if settings["antialiased"]:
        sharp_x, sharp_xy, sharp_y = shapes.sharp.T
        ratio = (sharp_x * sharp_y - sharp_xy * sharp_xy) / determinant
        opacity = opacity * np.sqrt(np.maximum(real(MIN_COMPENSATION), ratio))
    rectangles, is_outside = _tiles(shapes, determinant, opacity, view, rasterizer)
    kept = (z > nearest) & (determinant != 0) & ~is_outside & ~rectangles.empty
    # Compute the inverse of the covariance, and the slope (N, 2) of the depth over the screen.
    inverse = real(1) / determinant
    conic = np.stack([yy * inverse, -xy * inverse, xx * inverse], axis=1)
    with_x, with_y = shapes.with_depth.T
    rise = np.stack([yy * with_x - xy * with_y, xx * with_y - xy * with_x], axis=1) * inverse[:, None]

    def cover(faces: Integers, x: Reals, y: Reals) -> Reals:
        dx, dy = shapes.center[faces, 0] - x, shapes.center[faces, 1] - y
        a, b, c = conic[faces, 0], conic[faces, 1], conic[faces, 2]
        power = real(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy
        alpha = np.minimum(real(MAX_ALPHA), opacity[faces] * exponential(power))
        return np.asarray(np.where(power <= 0, alpha, real(0)))

    def shade(faces: Integers, x: Reals, y: Reals) -> Layers:
        dx, dy = shapes.center[faces, 0] - x, shapes.center[faces, 1] - y
        depth = z[faces] - (rise[faces, 0] * dx + rise[faces, 1] * dy)
        depth = np.maximum(depth, real(0.5) * nearest)
        return Layers(color[faces], depth, np.zeros((len(faces), 3), real))

    tiles, weights = modes.tiles(rectangles, z, kept, view), np.zeros(count)
    blended = composite(tiles, cover, shade, _RULE, view.width, view.height, dtype, weights)
    return ReferenceFrame(
        image=blended.over(background),
        alpha=blended.alpha,
        depth=expected_depth(blended.depth, blended.alpha),
        depth_median=blended.depth_median,
        normal=None,
        face_id=None,
        visible=kept,
        contribution=weights,
    )


def _project(
    covariance: Reals, mean: Reals, point: Reals, view: SplattingCamera, rasterizer: str
) -> Projected:
    """Return Gaussians on the screen.

    `covariance` (N, 6) is in world space, and `point` (N, 3) is in camera space.
    """
    real, z = mean.dtype.type, point[:, 2]
    size = np.array([view.width, view.height], real)
    focal = size / (2 * view.tan_fov)
    # Slopes (x / z, y / z) of the mean, clamped 30 % beyond the edges of the image.
    low, high = -real(1.3) * view.tan_fov, real(1.3) * view.tan_fov
    if rasterizer == "gsplat":  # gsplat clamps relative to the principal point
        middle, slack = size / 2 + view.shift, real(0.3) * view.tan_fov
        low, high = -(middle / focal + slack), (size - middle) / focal + slack
    tx = np.minimum(high[0], np.maximum(low[0], point[:, 0] / z)) * z
    ty = np.minimum(high[1], np.maximum(low[1], point[:, 1] / z)) * z
    # Rows of J W: the Jacobian of the projection times the rotation of the camera.
    w, zero = view.world_to_camera[:3, :3], np.zeros_like(z)
    p = _combine(w, focal[0] / z, zero, -(focal[0] * tx) / (z * z))
    q = _combine(w, zero, focal[1] / z, -(focal[1] * ty) / (z * z))
    # The product of J W with the covariance, and the three entries of the screen covariance.
    xx, xy, xz, yy, yz, zz = covariance.T
    columns = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    vp = [_sum(p, column) for column in columns]
    vq = [_sum(q, column) for column in columns]
    sharp = np.stack([_sum(vp, p), _sum(vp, q), _sum(vq, q)], axis=1)
    # Means on the screen, with the official division by w + 1e-7.
    clip = transform(view.full_projection, mean)
    shrink = real(1) / (clip[:, 3] + real(0.0000001))
    center = [ndc_to_pixel(clip[:, axis] * shrink, int(size[axis])) + view.shift[axis] for axis in range(2)]
    return Projected(
        center=np.stack(center, axis=1),
        covariance=sharp + np.array([DILATION, 0, DILATION], real),
        sharp=sharp,
        with_depth=np.stack([_sum(vp, w[2]), _sum(vq, w[2])], axis=1),
    )


def _tiles(
    shapes: Projected, determinant: Reals, opacity: Reals, view: SplattingCamera, rasterizer: str
) -> tuple[Rectangles, NDArray[np.bool_]]:
    """Return the tiles of N Gaussians, and a mask (N,) of Gaussians that the rasterizer drops."""
    real, center = opacity.dtype.type, shapes.center
    xx, _, yy = shapes.covariance.T
    if rasterizer == "gsplat":
        reach = np.sqrt(2 * np.log(opacity * real(255)))
        extent = np.minimum(real(MAX_EXTENT), reach)[:, None] * np.sqrt(np.stack([xx, yy], axis=1))
        rectangles, is_outside = gsplat_tiles(center, extent, view)
        return rectangles, is_outside | ~(opacity >= real(1) / real(255))
    half = real(0.5) * (xx + yy)
    largest = half + np.sqrt(np.maximum(real(MIN_SQUARE), half * half - determinant))
    rectangles = official_tiles(center, np.ceil(real(3) * np.sqrt(largest)), view)
    return rectangles, np.zeros(len(center), bool)


def official_tiles(center: Reals, radius: Reals, view: SplattingCamera) -> Rectangles:
    """Return the tiles of squares around `center` (N, 2) with half sides of `radius` (N,) samples."""
    grid, radius = grid_size(view.width, view.height), radius[:, None]
    return Rectangles(
        tile_number((center - radius) / TILE, grid), tile_number((center + radius + TILE - 1) / TILE, grid)
    )


def gsplat_tiles(center: Reals, extent: Reals, view: SplattingCamera) -> tuple[Rectangles, NDArray[np.bool_]]:
    """Return the tiles of boxes around `center`, and a mask of the boxes outside the raster. `extent` (N, 2)
    has the half sides of the boxes, which are rounded up."""
    grid, size = grid_size(view.width, view.height), np.array([view.width, view.height])
    radius = np.ceil(extent)
    low, high = center + center.dtype.type(0.5) - radius, center + center.dtype.type(0.5) + radius
    is_outside = ~((high > 0) & (low < size)).all(axis=1)
    first, last = tile_number(np.floor(low / TILE), grid), tile_number(np.ceil(high / TILE), grid)
    return Rectangles(first, last), is_outside


def _combine(w: Reals, x: Reals, y: Reals, z: Reals) -> list[Reals]:
    """Return the three columns (N,) of the product (x, y, z) w, for a matrix w (3, 3). Terms are added in the
    order x, y, z."""
    return [w[0, k] * x + w[1, k] * y + w[2, k] * z for k in range(3)]


def _sum(a: Any, b: Any) -> Reals:
    """Return the dot product of two vectors that are given as triples of columns (N,)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
