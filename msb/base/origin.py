"""The origin of a mesh far from zero, such as a survey in map coordinates.

float32 has 24 significant bits. float32 rounds a coordinate of 5,000,000 m to half a metre, which destroys a
mesh of a few metres. Positions of a mesh far from zero are therefore stored as float32 relative to a float64
origin. Compare relative positions to test whether two vertices are equal. This module chooses the origin of a
mesh.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Origin = tuple[float, float, float]
NO_ORIGIN: Origin = (0.0, 0.0, 0.0)

# A mesh needs an origin if the distance of its middle from zero is at least this many times its size. At
# this distance, float32 moves vertices by at most 2e-6 of the mesh size. A survey of 150 km in UTM
# coordinates is 36 times its size away from zero.
_FAR = 32.0
# Origins lie on a grid with this number of steps across the mesh. A finer grid would need more decimals for
# the origin.
_STEPS = 16
# Below this mesh size, float32 cannot store positions relative to an origin.
_TINY = 1e-30
# Maximum coordinate of an origin. Cameras reach 1e18.
_FARTHEST = 1e15
# Number of evenly spread vertices from which size and middle are computed.
_SAMPLES = 200_000
# Share of vertices to ignore as outliers at each end of an axis, such as a stray vertex at zero. Outliers are
# ignored only if the mesh has at least this number of vertices.
_OUTLIERS, _MANY = 0.01, 16


def find_origin(vertices: NDArray[Any]) -> Origin:
    """Return the origin of positions `vertices` (V, 3), or zero if the positions do not need an origin.

    float32 positions never need an origin, because they are exact. The origin is near the middle of the mesh.
    The origin is a multiple of a power of two, because differences to such an origin are usually exact.
    """
    if (vertices.dtype.kind, vertices.dtype.itemsize) != ("f", 8):
        return NO_ORIGIN
    rows = vertices[:: max(1, len(vertices) // _SAMPLES)]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return NO_ORIGIN
    # Compute sizes and middle (3,) of the bounding box without outliers.
    ordered = np.sort(rows, axis=0)
    cut = int(np.ceil(_OUTLIERS * len(rows))) if len(rows) >= _MANY else 0
    low, high = ordered[cut], ordered[len(rows) - 1 - cut]
    with np.errstate(over="ignore"):
        sizes, middle = high - low, low + (high - low) / 2
    size = float(sizes.max())
    # Vertices on a line along an axis are not a surface, so the mesh gets no origin.
    if np.count_nonzero(sizes > _TINY) < 2 or not _FAR * size <= np.abs(middle).max() <= _FARTHEST:
        return NO_ORIGIN
    step = 2.0 ** np.ceil(np.log2(size / _STEPS))
    x, y, z = (float(value) + 0.0 for value in np.rint(middle / step) * step)  # -0.0 becomes 0.0
    return x, y, z


def to_local(vertices: NDArray[Any], origin: ArrayLike) -> NDArray[np.float32]:
    """Return `vertices` (V, 3) as float32 relative to `origin`. A value beyond the range of float32 becomes
    infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        moved = vertices - np.asarray(origin, np.float64) if np.any(origin) else vertices
        return moved.astype(np.float32, copy=False)


def to_world(positions: NDArray[Any], origin: ArrayLike) -> NDArray[Any]:
    """Add `origin` to float32 `positions` (V, 3) in float64. Without an origin, return the positions
    unchanged."""
    return positions + np.asarray(origin, np.float64) if np.any(origin) else positions


def round_coordinates(vertices: NDArray[Any], origin: ArrayLike | None = None) -> NDArray[Any]:
    """Return `vertices` (V, 3) rounded to float32 relative to the origin.

    By default, the origin is computed from the vertices. The result is float64 if the mesh has an origin,
    otherwise float32.
    """
    origin = find_origin(vertices) if origin is None else origin
    return to_world(to_local(vertices, origin), origin)


def describe_origin(origin: Origin) -> str:
    """Return an origin as text, such as "(500000, 4649776, 100)"."""
    return f"({', '.join(f'{value:.15g}' for value in origin)})"
