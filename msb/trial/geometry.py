"""Areas, volumes and colours that several tasks need."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def corner_vectors(points: NDArray[Any], faces: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the two edges (F, d) float64 from each face's first corner."""
    first, second, third = (points[faces[:, k]].astype(np.float64) for k in range(3))
    return second - first, third - first


def areas(vertices: NDArray[Any], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the areas (F,) of the faces."""
    return np.asarray(np.linalg.norm(np.cross(*corner_vectors(vertices, faces)), axis=1) / 2)


def signed_volume(vertices: NDArray[Any], faces: NDArray[np.int64]) -> float:
    """Return the volume that a closed mesh encloses, negative where it is wound inwards.

    The sum of the tetrahedra between the faces and one point; a corner of the mesh, to keep rounding small.
    """
    if not len(faces):
        return 0.0
    corners = vertices[faces].astype(np.float64) - vertices[faces[0, 0]].astype(np.float64)
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def random_colors(labels: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return a bright colour (n, 3) for each label, the same every time; labels below 0 are black."""
    labels = np.maximum(labels, -1)
    palette = np.random.default_rng(7).uniform(0.25, 1.0, (int(labels.max(initial=0)) + 2, 3))
    palette[-1] = 0.0
    return palette[labels].astype(np.float32)
