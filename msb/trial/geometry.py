"""Edges and colours that several tasks need."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def corner_vectors(points: NDArray[Any], faces: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the two edges (F, d) float64 from each face's first corner."""
    first, second, third = (points[faces[:, k]].astype(np.float64) for k in range(3))
    return second - first, third - first


def random_colors(labels: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return a bright colour (n, 3) for each label, the same every time; labels below 0 are black."""
    labels = np.maximum(labels, -1)
    palette = np.random.default_rng(7).uniform(0.25, 1.0, (int(labels.max(initial=0)) + 2, 3))
    palette[-1] = 0.0
    return palette[labels].astype(np.float32)
