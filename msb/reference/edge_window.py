"""Triangles of Triangle-Splatting and MeshSplatting: projection, incentre and distances to the edges.

Sources: trianglesplatting/diff-triangle-rasterization at 6d61f4c: cuda_rasterizer/forward.cu, auxiliary.h;
meshsplatting/diff-triangle-mesh-rasterization at b27f283 (the same lines).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from msb.reference.arithmetic import (
    Reals,
    centroid,
    cross,
    cross_2d,
    dot,
    fast_power,
    ndc_to_pixel,
    norm,
    rotate,
    transform,
)
from msb.reference.camera_matrices import SplattingCamera
from msb.reference.engine import EngineTriangles, project_engine
from msb.reference.tiles import Integers, Modes

# Near and far plane of the official projection matrix, in scene units.
NEAR, FAR = 0.01, 100.0
# Faces whose centroid has at most this depth (camera z, scene units) are dropped.
NEAREST = 0.2
# Faces are dropped if the absolute cosine between the normal and the view direction is below this value.
GRAZING = 0.001
# Smallest divisor when a vector is normalised, in scene units. The divisor has square scene units for cross
# products of edges.
MIN_LENGTH = 1e-4
# Faces with an opacity below this value are dropped.
MIN_OPACITY = 0.01
# Faces with a corner farther than this many samples from their centroid are dropped.
MAX_RADIUS = 1600


@dataclass(frozen=True)
class Windows:
    """Projected faces on the screen, in samples; F is the number of faces.

    Methods of this class take face numbers, and the columns and rows of samples. Face and sample arrays are
    broadcast. Pass K faces as (K, 1) and P samples as (P,). For N faces with one sample each, pass (N,).
    """

    # (F,) whether a face is culled by distance, grazing view angle or size. Faces are also culled by opacity
    # and by tiles.
    dropped: NDArray[np.bool_]
    # (F,) camera z of the centroid: the sort key.
    depth: Reals
    # (F, 3) face normals in camera space, towards the camera. Face normals have length 1, or less for faces
    # with an area below 5e-5 square scene units.
    normal: Reals
    # (F, 3, 2)
    corners: Reals
    # (F, 3, 2) unit normals of the edges from corner k to k + 1, pointing outwards.
    edge_normal: Reals
    # (F, 3) edge offsets. The signed distance of a point q from an edge with normal n is n . q + offset,
    # which is positive outside.
    edge_offset: Reals
    # (F, 3) signed distance of the incentre from each edge. The distance is negative, and equal for all three
    # edges up to rounding.
    inradius: Reals
    # (F,) largest distance from a corner to the projected centroid.
    radius: Reals

    def phi(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the distance of samples to the nearest edge divided by the inradius; NaN outside a face."""
        normal, offset = self.edge_normal[faces], self.edge_offset[faces]
        first, second, third = (
            normal[..., k, 0] * x + normal[..., k, 1] * y + offset[..., k] for k in range(3)
        )
        nearest = np.fmax(np.fmax(first, second), third)
        return np.where(nearest > 0, np.nan, nearest * (1 / self.inradius[faces, 2]))

    def depth_at(self, faces: Integers, x: Reals, y: Reals) -> Reals:
        """Return the depth of the faces' centroids; the depth is constant over a face."""
        return np.asarray(self.depth[faces])

    def barycentrics(self, faces: Integers, x: Reals, y: Reals) -> tuple[Reals, Reals, Reals]:
        """Return the weights of the three corners of faces at samples. Weights are affine in screen space."""
        first, second, third = np.moveaxis(self.corners[faces], (-2, -1), (0, 1))
        e1, e2 = second - first, third - first
        e = x - first[0], y - first[1]
        inverse = 1 / cross_2d(e1, e2)
        b1 = cross_2d(e, e2) * inverse
        b2 = cross_2d(e1, e) * inverse
        return 1 - b1 - b2, b1, b2


def project_shapes(triangles: Reals, view: SplattingCamera, modes: Modes) -> Windows | EngineTriangles:
    """Return triangles (F, 3 corners, 3) on the screen, by the rules of the official code or of an engine."""
    if not modes.engine:
        return project_windows(triangles, view)
    shapes = project_engine(triangles, view, incentre=True)
    return replace(shapes, normal=shapes.facing_normal())


def project_windows(triangles: Reals, view: SplattingCamera) -> Windows:
    """Return triangles (F, 3 corners, 3) on the screen without clipping.

    Corners behind the camera are mirrored.
    """
    real = triangles.dtype.type
    center = centroid(triangles)
    camera = transform(view.world_to_camera[:3], center)
    dropped = camera[:, 2] <= real(NEAREST)
    normal, grazes = _facing_normals(triangles, camera, view)
    dropped |= grazes
    corners, middle = _to_samples(triangles, view), _to_samples(center, view)
    radius = np.fmax.reduce(norm(corners - middle[:, None]), axis=1, initial=0)

    # Compute the incentre: the corners weighted by the lengths of the opposite edges.
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    a, b, c = norm(second - third)[:, None], norm(first - third)[:, None], norm(first - second)[:, None]
    incentre = (a * first + b * second + c * third) / (a + b + c)

    # Compute edge normals and offsets, then turn the normals outwards: the incentre must have a negative
    # distance.
    start, end = corners, np.roll(corners, -1, axis=1)
    edge_normal = np.stack([end[..., 1] - start[..., 1], -(end[..., 0] - start[..., 0])], axis=-1)
    edge_normal = edge_normal * (1 / norm(edge_normal))[..., None]
    edge_offset = -dot(edge_normal, start)
    inradius = dot(edge_normal, np.broadcast_to(incentre[:, None], start.shape)) + edge_offset
    outward = np.where(inradius > 0, real(-1), real(1))
    edge_normal, edge_offset, inradius = (
        edge_normal * outward[..., None],
        edge_offset * outward,
        inradius * outward,
    )
    # NaN does not drop a face in these comparisons, as in the official code.
    dropped |= (radius > MAX_RADIUS) | (radius < 1) | (inradius[:, 2] > -1)
    return Windows(dropped, camera[:, 2], normal, corners, edge_normal, edge_offset, inradius, radius)


def _facing_normals(
    triangles: Reals, camera: Reals, view: SplattingCamera
) -> tuple[Reals, NDArray[np.bool_]]:
    """Return normals turned towards the camera, and a mask of faces seen edge-on.

    `camera` (F, 3) contains the centroids in camera space.
    """
    real = triangles.dtype.type
    normal = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = rotate(view.world_to_camera, normal)
    normal = normal / np.fmax(norm(normal), real(MIN_LENGTH))[:, None]
    towards = camera / np.fmax(norm(camera), real(MIN_LENGTH))[:, None]
    cosine = dot(normal, towards)
    normal = np.where(cosine[:, None] > 0, -normal, normal)
    return normal, np.abs(cosine) < real(GRAZING)


def _to_samples(points: Reals, view: SplattingCamera) -> Reals:
    """Return the raster positions (..., 2) of points (..., 3); sample (i, j) is centred at (i, j)."""
    h = transform(view.full_projection, points)
    inverse = 1 / (h[..., 3] + h.dtype.type(1e-7))
    x = ndc_to_pixel(h[..., 0] * inverse, view.width)
    y = ndc_to_pixel(h[..., 1] * inverse, view.height)
    return np.stack([x, y], axis=-1) + view.shift


def window_alpha(phi: Reals, opacity: Reals, sigma: Reals, cap: float) -> Reals:
    """Return min(cap, opacity phi^sigma) of K faces at P samples, (K, P); 0 outside the faces.

    Parameters
    ----------
    phi : (K, P)
        The window function: 0 on the edges (which belong to the face), 1 at the incentre, NaN outside.
    opacity, sigma : (K, 1)
    """
    inside = np.nonzero(~np.isnan(phi))
    face, alpha = inside[0], np.zeros_like(phi)
    coverage = np.fmax(0, fast_power(phi[inside], sigma[face, 0]))
    alpha[inside] = np.fmin(phi.dtype.type(cap), opacity[face, 0] * coverage)
    return alpha
