"""Sample points on a mesh at a given spacing, and thin them until no two are close.

The two functions follow eval.py of `jzhangbs/DTUeval-python`, which `hbb1/2d-gaussian-splatting` adapts in
scripts/eval_dtu/eval.py. Unlike eval.py, both functions limit memory and do not loop over faces.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.errors import MetricError

# Maximum number of samples of a mesh. A culled DTU scan has about ten million samples. The limit for sample
# candidates is twice this number.
MAX_SAMPLES = 1 << 28
# Number of sample candidates per batch.
_CANDIDATES = 1 << 20
# Number of points in the first window of `thin`.
_FIRST_WINDOW = 64
# Maximum number of points in a window of `thin`. The second number limits all neighbours of these points. If
# a window has only one point, it may have more neighbours than the limit.
_WINDOW = 1 << 16
_NEIGHBORS = 1 << 22


def mesh_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (V, 3) and faces (F, 3) after checking that they are finite and valid."""
    points, corners = np.asarray(vertices), np.asarray(faces)
    if corners.size == 0:
        corners = np.zeros((0, 3), np.int64)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        text = f"vertices are {points.dtype} of shape {points.shape}; they must be numbers of shape (V, 3)"
        raise MetricError("METRIC_MESH", text)
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        text = f"faces are {corners.dtype} of shape {corners.shape}; they must be integers of shape (F, 3)"
        raise MetricError("METRIC_MESH", text)
    points = points.astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MetricError("METRIC_MESH", f"vertex {row} has a coordinate that is not a finite number")
    outside = (corners < 0) | (corners >= len(points))
    if outside.any():
        row, corner = (int(i) for i in np.argwhere(outside)[0])
        text = f"faces[{row}, {corner}] is {corners[row, corner]}, but the mesh has {len(points)} vertices"
        raise MetricError("METRIC_MESH", text)
    return points, corners.astype(np.int64)


def sample_surface(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], spacing: float
) -> tuple[NDArray[np.float64], int]:
    """Return points on the faces, in the order of the faces, and the number of faces with a non-zero area.

    The points are about `spacing` apart, in the units of the vertices. A face has the edges e1 = v1 - v0 and
    e2 = v2 - v0 of lengths l1 and l2. The edges e1 and e2 have n = floor(l / step) steps, where step =
    spacing sqrt(l1 l2 / |e1 x e2|). The points are v0 + c1 e1 + c2 e2 with c = (i + 0.5) / n, for all c1 + c2
    < 1. A face with an edge e1 or e2 shorter than one step gets no points.
    """
    origin = vertices[faces[:, 0]]
    first, second = vertices[faces[:, 1]] - origin, vertices[faces[:, 2]] - origin
    with np.errstate(over="ignore", invalid="ignore"):
        double_area = np.linalg.norm(np.cross(first, second), axis=1)
    if not np.isfinite(double_area).all():
        raise _limit_error(np.inf, spacing)
    proper = double_area > 0
    origin, first, second, double_area = (array[proper] for array in (origin, first, second, double_area))
    # Compute the number of steps along both edges of each face, and the number of grid candidates.
    lengths = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
    step = spacing * np.sqrt(lengths[0] * lengths[1] / double_area)
    steps = [np.floor(length / step) for length in lengths]
    candidates = np.where((steps[0] > 0) & (steps[1] > 0), (steps[0] + 1) * (steps[1] + 1), 0.0)
    total = float(candidates.sum())
    if not total <= 2 * MAX_SAMPLES:
        raise _limit_error(total / 2, spacing)
    counts = np.stack(steps, axis=1).astype(np.int64)
    parts = [
        first[face] * along[:, :1] + second[face] * along[:, 1:] + origin[face]
        for face, along in _place_grid_points(counts, candidates.astype(np.int64))
    ]
    return np.concatenate([np.zeros((0, 3)), *parts]), int(np.count_nonzero(proper))


def _limit_error(points: float, spacing: float) -> MetricError:
    text = (
        f"sampling every {spacing:g} needs about {points:.3g} points; the limit is {MAX_SAMPLES:.3g};"
        " cull the mesh and scale it to millimetres"
    )
    return MetricError("METRIC_MESH", text)


def _place_grid_points(
    counts: NDArray[np.int64], candidates: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """In batches, yield the faces (n,) and positions (n, 2) of the sample points to keep.

    A position is the pair (c1, c2).

    Candidates are numbered across all faces. A huge face can exceed a batch, so it is split into several
    batches.
    """
    ends = np.cumsum(candidates)
    total = int(ends[-1]) if len(ends) else 0
    for start in range(0, total, _CANDIDATES):
        number = np.arange(start, min(start + _CANDIDATES, total))
        face = np.searchsorted(ends, number, side="right")
        inside = number - (ends[face] - candidates[face])
        slow, fast = np.divmod(inside, counts[face, 1] + 1)
        along = (np.stack([slow, fast], axis=1) + 0.5) / counts[face]
        keep = along.sum(axis=1) < 1
        yield face[keep], along[keep]


def thin(points: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Return thinned points of the points (N, 3). For each remaining point in turn, remove all other points
    within `spacing`.

    Shuffle the points before the call, because the first of two close points is kept. Points at a distance of
    exactly `spacing` are also removed. Neighbours are searched for one window of remaining points at a time.
    This limits memory. Windows start small and grow. In dense regions, the first few points remove most other
    points.
    """
    from scipy.spatial import cKDTree

    alive = np.ones(len(points), bool)
    if not len(points):
        return points
    tree = cKDTree(points)
    start, size = 0, _FIRST_WINDOW
    while start < len(points):
        window = start + np.flatnonzero(alive[start : start + size])
        if not len(window):
            start += size
            continue
        chosen = points[window]
        neighbors = tree.query_ball_point(chosen, spacing, workers=-1, return_length=True)
        # Limit the window so that its neighbour lists fit into memory.
        fits = max(1, int(np.searchsorted(np.cumsum(neighbors), _NEIGHBORS, side="right")))
        near: Any = tree.query_ball_point(chosen[:fits], spacing, workers=-1, return_sorted=False)
        for index, others in zip(window[:fits].tolist(), near, strict=True):
            if alive[index]:
                alive[others] = False
                alive[index] = True
        cut = fits < len(window)
        start = int(window[fits]) if cut else start + size
        size = max(_FIRST_WINDOW, min(_WINDOW, 4 * fits if cut else 2 * size))
    return points[alive]
