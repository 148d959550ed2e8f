"""Sampling of a splatting method's triangles by the rules of graphics hardware, as in a game engine.

Fragments exist only at pixel centres inside the projected triangle. Geometry nearer than the near plane is
clipped. Vertex attributes are interpolated with perspective correction. Faces are not sorted into tiles, and
are not culled by size or distance. The coverage window, colours and blending follow the method.

Barycentric coordinates divided by depth are affine on the screen, and so is 1 / depth. The barycentric
coordinates divided by depth are called homogeneous edge functions (Olano and Greer, "Triangle scan conversion
using 2D homogeneous coordinates", 1997). Polygons need no clipping: where a ray meets the triangle behind the
camera, all three functions are negative.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.reference.arithmetic import Reals, centroid, cross, dot, norm, transform
from msb.reference.camera_matrices import SplattingCamera
from msb.reference.tiles import TILE, Integers, Rectangles

# Camera depth of the near plane in scene units, as on the standard tier.
NEAR = 0.01
# The box of a triangle is widened by this number of samples, so that rounding does not cut off samples.
SLACK = 0.1
# Offset added to the low end of a box before rounding down to the first sample, as in splat_common.cl. The
# offset includes a sample just outside the box.
ALMOST_ONE = 0.999


@dataclass(frozen=True)
class EngineTriangles:
    """Projected triangles on the screen, in samples; sample (i, j) has its centre at (i, j).

    Faces and samples broadcast against each other, as in `msb.reference.edge_window.Windows`.

    Attributes
    ----------
    dropped : (F,) bool
        Whether the face is seen edge-on, has no area, is nearer than the near plane everywhere, or is outside
        the raster.
    back : (F,) bool
        Whether the corners are in clockwise order on the screen.
    depth : (F,)
        The sort key: camera z of the centroid, or 0 for centroids behind the camera.
    normal : (F, 3)
        Unit normal in camera space, oriented by the order of the corners.
    edges : (F, 3, 3)
        Barycentric coordinate k divided by depth, times weight k, as an affine function of a sample: factors
        of x and y, and a constant.
    inverse_depth : (F, 3)
        1 / depth as an affine function of a sample: factors of x and y, and a constant.
    weights : (F, 3)
        Factors of the barycentric coordinates. At the incentre or centroid all weighted coordinates are 1.
    rectangles : Rectangles
    """

    dropped: NDArray[np.bool_]
    back: NDArray[np.bool_]
    depth: Reals
    normal: Reals
    edges: Reals
    inverse_depth: Reals
    weights: Reals
    rectangles: Rectangles

    @property
    def radius(self) -> Reals:
        """The culling radius, which is 0, because an engine does not cull by radius."""
        return np.zeros_like(self.depth)

    def facing_normal(self) -> Reals:
        """Return the normals turned towards the camera."""
        return np.where(self.back[:, None], -self.normal, self.normal)

    def phi(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the smallest weighted barycentric coordinate of faces at samples.

        The result is 0 on the edges, 1 in the middle, and NaN at samples without a fragment.
        """
        first, second, third = self._weighted(faces, x, y)
        nearest = np.minimum(np.minimum(first, second), third)
        depth = self.depth_at(faces, x, y)
        fragment = (nearest >= 0) & (depth >= depth.dtype.type(NEAR)) & np.isfinite(depth)
        return np.where(fragment, nearest * depth, np.nan)

    def depth_at(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the camera depth of the faces' planes at samples."""
        return np.asarray(1 / _affine(self.inverse_depth[faces], x, y))

    def barycentrics(self, faces: Integers, x: Reals, y: Reals) -> tuple[Reals, Reals, Reals]:
        """Return the weights of the three corners of faces at samples.

        The weights are linear on the triangle in space.
        """
        (first, second, third), depth = self._weighted(faces, x, y), self.depth_at(faces, x, y)
        a, b, c = np.moveaxis(self.weights[faces], -1, 0)
        return first * depth / a, second * depth / b, third * depth / c

    def _weighted(self, faces: Integers, x: Reals, y: Reals) -> tuple[Reals, Reals, Reals]:
        """Return the three weighted barycentric coordinates of faces at samples, divided by depth."""
        first, second, third = np.moveaxis(self.edges[faces], -2, 0)
        return _affine(first, x, y), _affine(second, x, y), _affine(third, x, y)


def _affine(factors: Reals, x: Reals, y: Reals) -> Reals:
    """Return a x + c + b y at samples, for factors (a, b, c) (..., 3)."""
    a, b, c = np.moveaxis(factors, -1, 0)
    return np.asarray((a * x + c) + b * y)


def project_engine(triangles: Reals, view: SplattingCamera, *, incentre: bool) -> EngineTriangles:
    """Prepare triangles (F, 3 corners, 3) for sampling by the rules of graphics hardware.

    Parameters
    ----------
    incentre : bool
        If true, the window is 1 at the incentre. The window is the distance to the nearest edge divided by
        the inradius, both measured on the triangle in space. If false, the window is three times the smallest
        barycentric coordinate, so it is 1 at the centroid.

    Notes
    -----
    For corners p_k in camera space, normal N = (p_1 - p_0) x (p_2 - p_0) and a ray d = (x, y, 1): 1 / depth =
    N . d / V and b_k / depth = (p_i x (p_j - p_i)) . d / V with V = p_0 . N, where i and j are the two other
    corners, in order. Let h be the distance to the edge opposite corner k, divided by the inradius. Then h is
    b_k times the perimeter, divided by the length of the edge opposite corner k.
    """
    real = triangles.dtype.type
    corners = transform(view.world_to_camera[:3], triangles)
    following, last = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    opposite = last - following
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = dot(corners[:, 0], normal)
    # The comparison is written with "not >=", so that NaN drops a triangle.
    dropped = ~(np.abs(volume) >= np.finfo(np.float32).tiny)

    # Compute the weights of the barycentric coordinates (see Notes).
    if incentre:
        length = norm(opposite)
        perimeter = length[:, 0] + length[:, 1] + length[:, 2]
        weights = perimeter[:, None] / length
    else:
        weights = np.full((len(triangles), 3), 3, real)
    # Compute the affine functions of the sample's position.
    edges = _on_raster(cross(following, opposite), view) * (weights / volume[:, None])[..., None]
    inverse_depth = _on_raster(normal, view) * (1 / volume)[:, None]

    # Compute the boxes of samples, and the tiles that the boxes touch.
    first, final = _sample_box(corners, view)
    dropped |= (final < first).any(axis=1)
    depth = transform(view.world_to_camera[2:3], centroid(triangles))[:, 0]
    return EngineTriangles(
        dropped=dropped,
        back=volume > 0,
        depth=np.where(depth > 0, depth, real(0)),
        normal=normal / norm(normal)[:, None],
        edges=edges,
        inverse_depth=inverse_depth,
        weights=weights,
        rectangles=Rectangles(first // TILE, final // TILE + 1),
    )


def _scale(view: SplattingCamera) -> tuple[Reals, Reals]:
    """Return the difference (2,) between the rays of adjacent samples, and the sample (2,) on the optical
    axis."""
    size = np.array([view.width, view.height], view.tan_fov.dtype)
    return 2 * view.tan_fov / size, (size - 1) * size.dtype.type(0.5) + view.shift


def _on_raster(planes: Reals, view: SplattingCamera) -> Reals:
    """Return (a, b, c) for normals n (..., 3), such that n . ray = a x + b y + c at the sample (x, y)."""
    step, middle = _scale(view)
    a, b = planes[..., 0] * step[0], planes[..., 1] * step[1]
    return np.stack([a, b, (planes[..., 2] - a * middle[0]) - b * middle[1]], axis=-1)


def _sample_box(corners: Reals, view: SplattingCamera) -> tuple[Integers, Integers]:
    """Return the first and last samples (F, 2) of triangles in camera space, clipped at the near plane."""
    real = corners.dtype.type
    near, (step, middle) = real(NEAR), _scale(view)
    z, following = corners[..., 2], np.roll(corners, -1, axis=1)
    # Compute the points where edges cross the near plane. The points are valid only for edges that cross the
    # plane.
    share = (near - z) / (following[..., 2] - z)
    cut = corners[..., :2] + share[..., None] * (following[..., :2] - corners[..., :2])
    inside = z >= near
    crosses = inside != np.roll(inside, -1, axis=1)
    # Compute the box of the corners beyond the near plane and of the crossing points, on the raster.
    points = np.concatenate([corners[..., :2] / z[..., None], cut / near], axis=1) / step + middle
    seen = np.concatenate([inside, crosses], axis=1)[..., None]
    low = np.fmin.reduce(np.where(seen, points, np.inf), axis=1) - real(SLACK)
    high = np.fmax.reduce(np.where(seen, points, -np.inf), axis=1) + real(SLACK)
    size = np.array([view.width, view.height])
    first = np.clip(np.floor(low + real(ALMOST_ONE)), 0, size).astype(np.int64)
    return first, np.clip(np.floor(high), -1, size - 1).astype(np.int64)
