"""Fewer faces while the view moves: vertices of one cell of a grid become one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_FACES, LEAST_FACES = 300_000, 30_000
"""The most and fewest faces of a stand-in; a mesh of fewer than the fewest needs none."""
FLUID_SECONDS = 0.05
"""A picture that takes at most this many seconds is drawn in full while the view moves, too."""


def budget(faces: int, seconds: float) -> int | None:
    """Return how many faces to draw while moving, if all of them take `seconds`; None: all of them.

    >>> budget(1_000_000, 0.02), budget(1_000_000, 0.5), budget(4_000_000, 0.1), budget(10_000, 1.0)
    (None, 100000, 300000, None)
    """
    if seconds <= FLUID_SECONDS or faces <= LEAST_FACES:
        return None
    return int(min(max(faces * FLUID_SECONDS / seconds, LEAST_FACES), MOST_FACES))


def cluster(
    points: NDArray[np.float32], faces: NDArray[Any], target: int = MOST_FACES
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a coarse stand-in of a mesh.

    Parameters
    ----------
    points : (V, 3) float32
    faces : (F, 3) integers
    target : int
        Faces wanted, within a factor of about two.

    Returns
    -------
    faces : (f, 3) integers
        In terms of `points`: each cell of the grid is stood for by its first vertex.
    origin : (f,) integers
        The face each came from, for its colour.

    Notes
    -----
    Vertex clustering (J. Rossignac and P. Borrel, Multi-resolution 3D approximations for rendering complex
    scenes, 1993). Where there are far more faces than wanted they are sampled first, so time stays O(V + F)
    with one sort of the sample.
    """
    sample = np.arange(len(faces))
    if len(faces) > 4 * target:
        sample = np.random.default_rng(0).choice(len(faces), 4 * target, replace=False)
        sample.sort()
    some = faces[sample]
    if len(some) == 0:
        return some, sample
    low, high = points[some].reshape(-1, 3).min(axis=0), points[some].reshape(-1, 3).max(axis=0)
    # A surface through an n^3 grid meets a few n^2 cells, each with about four faces.
    cells = max(int(np.sqrt(target / 4)), 8)
    size = max(float((high - low).max()) / cells, 1e-9)
    used = np.unique(some)
    place = np.floor((points[used] - low) / size).astype(np.int64)
    key = (place[:, 0] * (cells + 2) + place[:, 1]) * (cells + 2) + place[:, 2]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    stand_in = np.zeros(len(points), some.dtype)
    stand_in[used] = used[first][inverse]
    coarse = stand_in[some]
    a, b, c = coarse.T
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    rows = np.sort(coarse[whole], axis=1).astype(np.int64)
    _, once = np.unique((rows[:, 0] * len(points) + rows[:, 1]) ^ (rows[:, 2] << 40), return_index=True)
    keep = whole[np.sort(once)]
    if len(keep) > 2 * target:
        keep = keep[:: len(keep) // target]
    return coarse[keep], sample[keep]
