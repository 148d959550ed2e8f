"""2DTS: a triangle soup with a Gaussian-like falloff, drawn by two rasterizers.

The sharpness gamma of the falloff is global.

Sources, at 54c80f7 of GaodeRender/triangle-splatting: src/diff_recon/models/VanillaTS_model.py (activations,
gamma rescale, threshold, up-scaling), submodules/diff-triangle-rasterization-2D and -3D: src/forward.cu,
src/auxiliary.h (per triangle and per sample).
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.reference.arithmetic import (
    Reals,
    centroid,
    cross,
    cross_2d,
    dot,
    exponential,
    ndc_to_pixel,
    norm,
    power,
    rotate,
    transform,
)
from msb.reference.blend import Layers, Rule, composite, expected_depth
from msb.reference.camera_matrices import SplattingCamera, splatting_camera
from msb.reference.engine import project_engine
from msb.reference.frame import ReferenceFrame
from msb.reference.parameters import opacities, sh_coefficients, triangles
from msb.reference.sh import colors_from_sh
from msb.reference.tiles import TILE, Integers, Modes, Rectangles, grid_size, tile_number
from msb.scenes import Camera

# Near and far planes of the official projection matrix, in scene units.
NEAR, FAR = 1.0, 1000.0
# Minimum divisor and minimum area of the official kernels.
EPS = 1e-8
# Ratio between the size of a triangle's bounds and the size of the triangle, measured from the centroid.
DILATION = 3
# Upper limits of alpha and of the eccentricity.
MAX_ALPHA = 0.99
MAX_ECCENTRICITY = 10
_RULE = Rule(blends_crossing=True, weight_first=True)


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
) -> ReferenceFrame:
    """Return the frame of `asset` from `camera`; see `render_reference`."""
    scale = settings["render_up_scale"] or 1
    view = splatting_camera(camera, NEAR, FAR, dtype, scale)
    stored = triangles(asset, dtype)
    faces = len(stored)
    gamma = dtype(settings["gamma"])
    # Compute the activated parameters of the F triangles.
    vertices = rescale(stored, settings["gamma"]) if settings["gamma_rescale"] else stored
    opacity = opacities(asset, faces, dtype)
    if settings["ste_threshold"] is not None:
        opacity = straight_through(opacity, settings["ste_threshold"])
    coefficients = sh_coefficients(asset, faces, dtype)
    color = colors_from_sh(coefficients, centroid(vertices), view.center, settings["sh_degree"])
    raster: EngineRasterizer | AffineRasterizer | PlanarRasterizer
    if modes.engine:
        reached = reach(opacity, settings["gamma"])
        raster = EngineRasterizer(vertices, view, settings["back_culling"], reached)
    else:
        official = AffineRasterizer if settings["rasterizer"] == "2D" else PlanarRasterizer
        raster = official(vertices, view, settings["back_culling"])

    def cover(chosen: Integers, x: Reals, y: Reals) -> Reals:
        return coverage_alpha(raster.eccentricity(chosen, x, y), opacity[chosen], gamma)

    def shade(chosen: Integers, x: Reals, y: Reals) -> Layers:
        return Layers(color[chosen], raster.depth_at(chosen, x, y), raster.normal[chosen])

    # Blend all samples, then reduce them to pixels.
    kept = ~raster.dropped
    tiles = modes.tiles(raster.rectangles, raster.depth, kept, view)
    weights = np.zeros(len(kept))
    blended = composite(tiles, cover, shade, _RULE, view.width, view.height, dtype, weights)
    background_depth = norm(view.center - stored).max()
    alpha = resize(blended.alpha, scale)
    return ReferenceFrame(
        image=resize(blended.over(background), scale),
        alpha=alpha,
        depth=expected_depth(resize(blended.depth, scale), alpha),
        depth_median=None,
        normal=resize(blended.normal, scale),
        face_id=None,
        visible=kept,
        contribution=weights,
        raw={
            "transmittance": blended.transmittance,
            "depth": blended.depth + blended.transmittance * background_depth,
            "normal": blended.normal,
            "radii": np.where(kept, raster.radius, 0).astype(np.int32),
            "bg_depth": background_depth,
            "full_proj": view.full_projection,
            "camera_center": view.center,
        },
    )


def rescale(vertices: Reals, gamma: float) -> Reals:
    """Return triangles (F, 3, 3), shrunk about their centroids.

    The factor keeps the total opacity equal for every gamma.

    The scale factor is 1 / sqrt(2^b b Gamma(b)) with b = 1 / gamma, computed in double and rounded.
    """
    beta = 1 / gamma
    factor = vertices.dtype.type(1 / math.sqrt(2**beta * beta * math.gamma(beta)))
    center = centroid(vertices)[:, None]
    return np.asarray((vertices - center) * factor + center)


def straight_through(opacity: Reals, threshold: float) -> Reals:
    """Return 1 for opacities above the threshold, otherwise 0.

    Rounding may give a float next to 1, as in the official expression.
    """
    step = (opacity > opacity.dtype.type(threshold)).astype(opacity.dtype)
    return np.asarray((step - opacity) + opacity)


def coverage_alpha(eccentricity: Reals, opacity: Reals, gamma: Any) -> Reals:
    """Return min(0.99, o exp(-ecc^(2 gamma) / 2)), or 0 for eccentricities outside 0 to 10.

    Parameters
    ----------
    eccentricity : (K, P)
        Eccentricity, 0 at the centroid and 1 on the edges; NaN for samples whose ray misses the face's plane.
    opacity : (K, 1)
    """
    near = (eccentricity >= 0) & (eccentricity <= MAX_ECCENTRICITY)
    alpha = np.zeros_like(eccentricity)
    falloff = exponential(-0.5 * power(eccentricity[near], 2 * gamma))
    alpha[near] = np.minimum(
        eccentricity.dtype.type(MAX_ALPHA), np.broadcast_to(opacity, near.shape)[near] * falloff
    )
    return alpha


def bounds(points: Reals, width: int, height: int) -> tuple[Rectangles, Reals]:
    """Return the tiles of a box around dilated corners (F, 3, 2), and the official radius (F,) in samples."""
    low, high = np.fmin.reduce(points, axis=1), np.fmax.reduce(points, axis=1)
    grid = grid_size(width, height)
    rectangles = Rectangles(tile_number(low / TILE, grid), tile_number((high + TILE - 1) / TILE, grid))
    return rectangles, np.ceil((high - low) * 0.5).max(axis=1)


def project(points: Reals, view: SplattingCamera) -> Reals:
    """Return normalised device coordinates of points (..., 3); the divisor is |w| + eps instead of w.

    Points behind the camera therefore have a negative z and fail the near test.
    """
    h = transform(view.full_projection, points)
    return np.asarray(h[..., :3] * (1 / (np.abs(h[..., 3:]) + h.dtype.type(EPS))))


class AffineRasterizer:
    """The "2D" rasterizer: perspective is linearised at the centroid, and corners are moved outwards by 0.5
    px.

    Faces and samples broadcast against each other, as in `msb.reference.edge_window.Windows`. Attributes of F
    triangles: `dropped` (F,), `depth` (F,), `normal` (F, 3), `rectangles`, `radius` (F,).
    """

    def __init__(self, vertices: Reals, view: SplattingCamera, back_culling: bool) -> None:
        eps = vertices.dtype.type(EPS)
        size = np.array([view.width, view.height], vertices.dtype)
        center = centroid(vertices)
        ndc = project(center, view)
        self.dropped: NDArray[np.bool_] = ndc[:, 2] <= 0
        camera = transform(view.world_to_camera[:3], center)
        self.depth = camera[:, 2]
        # The clamp affects only the Jacobian, not the projected centroid.
        limit = vertices.dtype.type(1.3) * view.tan_fov * camera[:, 2:]
        clamped = np.fmin(np.fmax(-limit, camera[:, :2]), limit)
        arms = rotate(view.world_to_camera, vertices - center[:, None])
        normal = cross(arms[:, 0], arms[:, 1])
        length = norm(normal)
        self.dropped |= length < eps
        self.normal = normal / length[:, None]
        # Subtract the projected centroid from the corners. Then move the corners outwards by half a sample.
        z = self.depth[:, None, None]
        flat = (arms[..., :2] - arms[..., 2:] * clamped[:, None] / z) / (z * view.tan_fov)
        reach = norm(flat)[..., None]
        self.dropped |= (reach < eps).any(axis=(1, 2))
        flat = flat * (0.5 * size + 0.5 / reach)
        middle = np.stack([ndc_to_pixel(ndc[:, 0], view.width), ndc_to_pixel(ndc[:, 1], view.height)], axis=1)
        middle = (middle + view.shift)[:, None]
        self.corners = middle + flat
        first, second, third = np.moveaxis(self.corners, (1, 2), (0, 1))
        self.area = cross_2d(second - first, third - first)
        # The y axis points down, so a front face (counter-clockwise on the screen) has a negative area.
        self.dropped |= self.area >= -eps if back_culling else np.abs(self.area) < eps
        self.rectangles, self.radius = bounds(middle + DILATION * flat, view.width, view.height)
        self.dropped |= ((self.rectangles.high - self.rectangles.low) <= 0).any(axis=1)
        self.corner_depth = arms[..., 2] + self.depth[:, None]

    def barycentrics(self, faces: Integers, x: Reals, y: Reals) -> tuple[Reals, Reals, Reals]:
        """Return the weights of the three corners of faces at samples."""
        corners = np.moveaxis(self.corners[faces], (-2, -1), (0, 1))
        first, second, third = ((corner[0] - x, corner[1] - y) for corner in corners)
        area = self.area[faces]
        a1, a2 = cross_2d(second, third) / area, cross_2d(third, first) / area
        return a1, a2, 1 - a1 - a2

    def eccentricity(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the eccentricity of samples in faces."""
        return eccentricity(*self.barycentrics(faces, x, y))

    def depth_at(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the depth of faces at samples, extrapolated outside the faces."""
        a1, a2, a3 = self.barycentrics(faces, x, y)
        z = self.corner_depth[faces]
        return np.asarray(z[..., 0] * a1 + z[..., 1] * a2 + z[..., 2] * a3)


class PlanarRasterizer:
    """The "3D" rasterizer: the ray of every sample is intersected with the triangle's plane; no low-pass
    filter.

    The attributes are explained at `AffineRasterizer`; the length of the normal is twice the triangle's area.
    """

    def __init__(self, vertices: Reals, view: SplattingCamera, back_culling: bool) -> None:
        self.view = view
        self.corners = transform(view.world_to_camera[:3], vertices)
        first, second, third = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        self.depth = centroid(self.corners)[:, 2]
        self.normal = cross(second - first, third - first)
        self.dropped: NDArray[np.bool_] = norm(self.normal) < vertices.dtype.type(EPS)
        if back_culling:
            self.dropped |= self.normal[:, 2] >= 0
        center = centroid(vertices)[:, None]
        ndc = project(center + DILATION * (vertices - center), view)
        self.dropped |= (ndc[..., 2] <= 0).any(axis=1)
        size = np.array([view.width, view.height], vertices.dtype)
        points = (ndc[..., :2] + 1) * size * 0.5 - 0.5 + view.shift
        self.rectangles, self.radius = bounds(points, view.width, view.height)
        self.dropped |= ((self.rectangles.high - self.rectangles.low) <= 0).any(axis=1)

    def eccentricity(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the eccentricity of samples in faces; NaN if the ray does not meet the face's plane."""
        ray, slope, depth = self._meet(faces, x, y)
        normal = self.normal[faces]
        arms = self.corners[faces] - (depth[..., None] * ray)[..., None, :]
        scale = 1 / dot(normal, normal)
        a1 = dot(cross(arms[..., 1, :], arms[..., 2, :]), normal) * scale
        a2 = dot(cross(arms[..., 2, :], arms[..., 0, :]), normal) * scale
        meets = np.abs(slope) >= slope.dtype.type(EPS)
        return np.where(meets, eccentricity(a1, a2, 1 - a1 - a2), np.nan)

    def depth_at(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the depth of the faces' planes at samples."""
        return self._meet(faces, x, y)[2]

    def _meet(self, faces: Integers, x: Reals, y: Reals) -> tuple[Reals, Reals, Reals]:
        """Return rays (..., 3) with z = 1, their products with the normals, and depths on the planes."""
        width, height = self.view.width, self.view.height
        (shift_x, shift_y), (tan_x, tan_y) = self.view.shift, self.view.tan_fov
        ray_x = tan_x * ((2 * (x - shift_x) - width + 1) / width)
        ray_y = tan_y * ((2 * (y - shift_y) - height + 1) / height)
        ray = np.stack([ray_x, ray_y, np.ones_like(x)], axis=-1)
        normal = self.normal[faces]
        slope = dot(ray, normal)
        return ray, slope, dot(self.corners[faces][..., 0, :], normal) / slope


class EngineRasterizer:
    """Draws the triangles of both rasterizers by the rules of graphics hardware: exact perspective, no
    low-pass filter.


    Graphics hardware draws nothing outside a triangle, but the falloff of this method extends beyond the
    edges. Each triangle is enlarged about its centroid until it contains the whole falloff. A game engine can
    enlarge triangles in a vertex shader.

    `AffineRasterizer` explains the attributes. The attribute `radius` is 0. Pass the result of the function
    `reach` as `reached` (F,).
    """

    def __init__(self, vertices: Reals, view: SplattingCamera, back_culling: bool, reached: Reals) -> None:
        center, self.reached = centroid(vertices)[:, None], reached
        grown = center + reached[:, None, None] * (vertices - center)
        self.shapes = shapes = project_engine(grown, view, incentre=False)
        self.dropped: NDArray[np.bool_] = shapes.dropped | ~(reached > 0) | (shapes.back & back_culling)
        self.depth, self.normal = shapes.depth, shapes.normal
        self.rectangles, self.radius = shapes.rectangles, shapes.radius

    def eccentricity(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the eccentricity of samples in faces; NaN for samples without a fragment."""
        # At the centroid, rounding may give a negative eccentricity.
        return np.asarray(self.reached[faces] * np.maximum(1 - self.shapes.phi(faces, x, y), 0))

    def depth_at(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the depth of the faces' planes at samples."""
        return self.shapes.depth_at(faces, x, y)


def reach(opacity: Reals, gamma: float) -> Reals:
    """Return the eccentricity beyond which alpha is less than 1/255, but at most 10.

    At eccentricity ecc, alpha is o exp(-ecc^(2 gamma) / 2). The result is slightly increased to allow for
    rounding. The result is 0 if alpha is below 1/255 even at the centroid.
    """
    squared = 2 * np.log(255 * np.maximum(opacity.astype(np.float64), 1e-300)) + 1e-5
    limit = np.maximum(squared, 0) ** (1 / (2 * gamma)) * 1.0001
    return np.asarray(np.minimum(limit, MAX_ECCENTRICITY), opacity.dtype)


def eccentricity(a1: Reals, a2: Reals, a3: Reals) -> Reals:
    """Return 1 - 3 min(a1, a2, a3) of barycentric coordinates: 0 at the centroid, 1 on the edges."""
    return np.asarray(1 - 3 * np.minimum(np.minimum(a1, a2), a3))


def resize(raster: Reals, scale: int) -> Reals:
    """Return (s H, s W, ...) reduced to (H, W, ...) by bilinear interpolation at pixel centres.

    The result equals torch's interpolate(mode="bilinear", align_corners=False). If the scale is even, a
    pixel is the mean of the middle 2 x 2 samples. If the scale is odd, a pixel is the sample in the middle.
    """
    if scale == 1:
        return raster
    first, second = (scale - 1) // 2, scale // 2
    if first == second:
        return raster[first::scale, first::scale]
    top, bottom = raster[first::scale], raster[second::scale]
    upper = 0.5 * top[:, first::scale] + 0.5 * top[:, second::scale]
    lower = 0.5 * bottom[:, first::scale] + 0.5 * bottom[:, second::scale]
    return np.asarray(0.5 * upper + 0.5 * lower)
