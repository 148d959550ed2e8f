"""What Triangle-Splatting and MeshSplatting share: projected triangles, their incentre and edge distances.

Sources: trianglesplatting/diff-triangle-rasterization at 6d61f4c: cuda_rasterizer/forward.cu, auxiliary.h;
meshsplatting/diff-triangle-mesh-rasterization at b27f283 (the same lines).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msb.reference.arithmetic import (
    Reals,
    centroid,
    cross,
    dot,
    fast_power,
    ndc_to_pixel,
    norm,
    rotate,
    transform,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.reference.camera_matrices import SplattingCamera
    from msb.reference.tiles import Integers

NEAR, FAR = 0.01, 100.0
NEAREST = 0.2
"""A face whose centroid is not farther than this along z is dropped."""
GRAZING = 0.001
"""A face is dropped where the cosine between its normal and the view is below this."""
MIN_LENGTH = 1e-4
MIN_OPACITY = 0.01
MAX_RADIUS = 1600
"""In samples."""


@dataclass(frozen=True)
class Windows:
    """F faces on the screen, in samples.

    Attributes
    ----------
    dropped : (F,) bool
        By distance, grazing view or size; opacity and tiles are the methods' own matter.
    depth : (F,)
        Camera z of the centroid: the sort key.
    normal : (F, 3)
        Unit normal in camera space, towards the camera; shorter for faces below 5e-5 square units.
    corners : (F, 3, 2)
    edge_normal : (F, 3, 2)
        Of the edges from corner k to k + 1, outwards, unit length.
    edge_offset : (F, 3)
        A point q is n . q + offset outside of an edge.
    inradius : (F, 3)
        That distance of the incentre, negative; the same for the three edges but for rounding.
    radius : (F,)
        The largest distance from a corner to the projected centroid.
    """

    dropped: NDArray[np.bool_]
    depth: Reals
    normal: Reals
    corners: Reals
    edge_normal: Reals
    edge_offset: Reals
    inradius: Reals
    radius: Reals


def project_windows(triangles: Reals, view: SplattingCamera) -> Windows:
    """Return triangles (F, 3 corners, 3) projected, not clipped: behind the camera they are mirrored."""
    real = triangles.dtype.type
    center = centroid(triangles)
    camera = transform(view.world_to_camera[:3], center)
    dropped = camera[:, 2] <= real(NEAREST)
    normal, grazes = _facing_normals(triangles, camera, view)
    dropped |= grazes
    corners, middle = _to_samples(triangles, view), _to_samples(center, view)
    radius = np.fmax.reduce(norm(corners - middle[:, None]), axis=1, initial=0)

    # Incentre: corners weighted by the lengths of the opposite edges.
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    a, b, c = norm(second - third)[:, None], norm(first - third)[:, None], norm(first - second)[:, None]
    incentre = (a * first + b * second + c * third) / (a + b + c)

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
    # Not "<= 1": a NaN must not drop a face here.
    dropped |= (radius > MAX_RADIUS) | (radius < 1) | (inradius[:, 2] > -1)
    return Windows(dropped, camera[:, 2], normal, corners, edge_normal, edge_offset, inradius, radius)


def _facing_normals(
    triangles: Reals, camera: Reals, view: SplattingCamera
) -> tuple[Reals, NDArray[np.bool_]]:
    """Return normals towards the camera, and which faces are seen edge-on; `camera` (F, 3) are centroids."""
    real = triangles.dtype.type
    normal = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = rotate(view.world_to_camera, normal)
    normal = normal / np.fmax(norm(normal), real(MIN_LENGTH))[:, None]
    towards = camera / np.fmax(norm(camera), real(MIN_LENGTH))[:, None]
    cosine = dot(normal, towards)
    normal = np.where(cosine[:, None] > 0, -normal, normal)
    return normal, np.abs(cosine) < real(GRAZING)


def _to_samples(points: Reals, view: SplattingCamera) -> Reals:
    """Return where points (..., 3) are on the raster, (..., 2); sample (i, j) has its centre at (i, j)."""
    h = transform(view.full_projection, points)
    inverse = 1 / (h[..., 3] + h.dtype.type(1e-7))
    x = ndc_to_pixel(h[..., 0] * inverse, view.width)
    y = ndc_to_pixel(h[..., 1] * inverse, view.height)
    return np.stack([x, y], axis=-1) + view.shift


def window_alpha(
    windows: Windows, faces: Integers, x: Reals, y: Reals, opacity: Reals, sigma: Reals, cap: float
) -> Reals:
    """Return min(cap, o phi^sigma) of K faces at P samples, (K, P); 0 outside.

    phi is the distance to the nearest edge, 0 on an edge (which is inside) and 1 at the incentre.

    Parameters
    ----------
    opacity, sigma : (K,)
    """
    normal, offset = windows.edge_normal[faces, :, :, None], windows.edge_offset[faces, :, None]
    distances = normal[:, :, 0] * x + normal[:, :, 1] * y + offset
    nearest: Reals = np.fmax.reduce(distances, axis=1)
    face, sample = np.nonzero(~(nearest > 0))
    phi = nearest[face, sample] * (1 / windows.inradius[faces, 2])[face]
    alpha = np.zeros_like(nearest)
    coverage = np.fmax(0, fast_power(phi, sigma[face]))
    alpha[face, sample] = np.fmin(phi.dtype.type(cap), opacity[face] * coverage)
    return alpha
