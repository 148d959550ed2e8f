"""Differentiable screen geometry of triangles: torch versions of the per-triangle code of the references.

All values are float64, and the order of operations is that of the references. Therefore pixels on edges are
on the same side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

from msb.asset.sh import SH_C0, sh_basis

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msb.reference.camera_matrices import SplattingCamera


def rows_of(matrix: NDArray[np.float64]) -> list[list[float]]:
    """Return a matrix as numbers."""
    found: list[list[float]] = matrix.tolist()
    return found


def transform(matrix: NDArray[np.float64], points: torch.Tensor) -> torch.Tensor:
    """Return M (x, y, z, 1) for points (..., 3) and the rows of M (R, 4): (..., R)."""
    x, y, z = points.unbind(-1)
    return torch.stack([a * x + b * y + c * z + d for a, b, c, d in rows_of(matrix)], -1)


def rotate(matrix: NDArray[np.float64], vectors: torch.Tensor) -> torch.Tensor:
    """Return the 3x3 part of M times vectors (..., 3)."""
    x, y, z = vectors.unbind(-1)
    return torch.stack([a * x + b * y + c * z for a, b, c, _ in rows_of(matrix[:3])], -1)


def norm(vectors: torch.Tensor) -> torch.Tensor:
    """Return the length along the last axis; squares are summed from the first component to the last."""
    first, *others = vectors.unbind(-1)
    total = first * first
    for other in others:
        total = total + other * other
    return total.sqrt()


def centroid(triangles: torch.Tensor) -> torch.Tensor:
    """Return (v1 + v2 + v3) / 3 of triangles (..., 3 corners, 3)."""
    first, second, third = triangles.unbind(-2)
    return (first + second + third) / 3


def ndc_to_pixel(ndc: torch.Tensor, size: int) -> torch.Tensor:
    """Return ((ndc + 1) size - 1) / 2."""
    return ((ndc + 1) * size - 1) * 0.5


def to_samples(points: torch.Tensor, view: SplattingCamera) -> torch.Tensor:
    """Return the raster coordinates (..., 2) of points (..., 3) in the Triangle-Splatting family."""
    h = transform(view.full_projection, points)
    inverse = 1 / (h[..., 3] + 1e-7)
    x = ndc_to_pixel(h[..., 0] * inverse, view.width) + float(view.shift[0])
    y = ndc_to_pixel(h[..., 1] * inverse, view.height) + float(view.shift[1])
    return torch.stack([x, y], -1)


def edge_distances(corners: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return rows (n_x, n_y, t) of the edges of corners (G, 3, 2), and inradii; both are negative inside.

    The conventions are those of `msb.reference.edge_window.project_windows`. Row k (G, 3, 3) gives the
    distance from the edge between corners k and k + 1. The inradius (G,) is the distance of the incentre from
    the last edge.
    """
    first, second, third = corners.unbind(1)
    a, b, c = norm(second - third), norm(first - third), norm(first - second)
    a, b, c = a[:, None], b[:, None], c[:, None]
    incentre = (a * first + b * second + c * third) / (a + b + c)
    end = corners.roll(-1, 1)
    normal = torch.stack([end[..., 1] - corners[..., 1], -(end[..., 0] - corners[..., 0])], -1)
    normal = normal * (1 / norm(normal))[..., None]
    offset = -(normal[..., 0] * corners[..., 0] + normal[..., 1] * corners[..., 1])
    inner = normal[..., 0] * incentre[:, None, 0] + normal[..., 1] * incentre[:, None, 1] + offset
    outward = 1 - 2 * (inner.detach() > 0).double()
    rows = torch.cat([normal * outward[..., None], (offset * outward)[..., None]], -1)
    return rows, inner[:, 2] * outward[:, 2]


def barycentric_rows(corners: torch.Tensor) -> torch.Tensor:
    """Return rows (a, b, c), (G, 3, 3): the weights a x + b y + c of corners (G, 3, 2) on the screen."""
    first, second, third = corners.unbind(1)
    (e1x, e1y), (e2x, e2y) = (second - first).unbind(-1), (third - first).unbind(-1)
    inverse = 1 / (e1x * e2y - e1y * e2x)
    x, y = first.unbind(-1)
    b1 = torch.stack([e2y * inverse, -e2x * inverse, (y * e2x - x * e2y) * inverse], -1)
    b2 = torch.stack([-e1y * inverse, e1x * inverse, (x * e1y - y * e1x) * inverse], -1)
    whole = torch.tensor([0.0, 0.0, 1.0], dtype=corners.dtype)
    return torch.stack([whole - b1 - b2, b1, b2], 1)


def colors_from_sh(
    coefficients: torch.Tensor, points: torch.Tensor, center: NDArray[Any], degree: int
) -> torch.Tensor:
    """Return colours max(0.5 + sum_k B_k(d) c_k, 0), (n, 3); d is from the camera to `points` (n, 3)."""
    offsets = points - torch.from_numpy(center)
    directions: Any = offsets / norm(offsets)[:, None]
    color = SH_C0 * coefficients[:, 0]
    for number, value in enumerate(sh_basis(directions, degree), start=1):
        color = color + torch.as_tensor(value)[:, None] * coefficients[:, number]
    return (color + 0.5).clamp(min=0)
