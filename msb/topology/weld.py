"""Merge coincident vertices.

This weld is optional in the audit, which reports its result separately.
"""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.base.origin import find_origin, to_local
from msb.errors import MeshError
from msb.topology.components import label_components

Weld = Literal["exact"] | float

# Maximum number of vertex pairs within the weld distance. The indices of this number of pairs take 1 GiB. In
# a typical weld, there are about as many pairs as vertices.
MAX_PAIRS = 1 << 26


def parse_weld(text: str | float) -> Weld:
    """Return the weld setting given as `text`: "exact", or a positive finite length."""
    if text == "exact":
        return "exact"
    try:
        # A bool is rejected, although it is a number in Python.
        distance = math.nan if isinstance(text, bool | np.bool_) else float(text)
    except (ValueError, TypeError, OverflowError):
        distance = math.nan
    if not (distance > 0 and math.isfinite(distance)):
        raise MeshError("WELD_DISTANCE", f'invalid weld "{text}"; use exact or a positive length')
    return distance


def weld_vertices(
    vertices: NDArray[Any], faces: NDArray[Any], weld: Weld
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return vertices (W, 3) and faces (F, 3) after merging coincident vertices. All face rows stay in the
    result.

    "exact" merges vertices with equal stored coordinates: float32, relative to the origin of the mesh
    (`msb.base.origin`). The value -0 equals +0, and NaN equals nothing. A length merges vertices through
    chains of steps. Each step has at most this length. The result therefore does not depend on the order of
    the vertices. The first vertex of each merged set is kept. The kept vertices stay in order. Faces that
    collapse become repeated-index rows.
    """
    first, number = merge_coincident(vertices, weld)
    return vertices[first], number.astype(faces.dtype)[faces]


def merge_coincident(vertices: NDArray[Any], weld: Weld) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the first vertex (W,) of each merged set, and the index (V,) of the set that contains each
    vertex.

    Sets are ordered by their first vertex.
    """
    if len(vertices) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    labels = _label_exact(_to_stored(vertices)) if weld == "exact" else _label_near(vertices, float(weld))
    _, first, number = np.unique(labels, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def corners_coincide(vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether an exact weld would join any two faces of a triangle soup.

    The function hashes positions to 32 bits, sorts the hashes, and compares positions with equal hashes.
    """
    bits, corners = _to_stored(vertices).view(np.uint32), faces.reshape(-1)
    hashes, repeated = _hash_rows(bits, corners)
    start, count = 0, 64  # The first few hashes usually suffice to find coincident corners.
    while start < len(repeated):
        bucket = np.zeros(1 << 20, bool)
        # Preselect corners by the upper 20 bits of their hash, then compare coordinates and faces.
        bucket[repeated[start : start + count] >> 12] = True
        corner = np.flatnonzero(bucket[hashes >> 12])
        rows = np.column_stack([bits[corners[corner]], corner // 3])
        rows = rows[~np.isnan(rows[:, :3].astype(np.uint32).view(np.float32)).any(axis=1)]
        rows = np.unique(rows, axis=0)  # Coincident corners of a single face join no faces.
        if (rows[1:, :3] == rows[:-1, :3]).all(axis=1).any():
            return True
        start, count = start + count, count << 8
    return False


def find_coincident_vertices(vertices: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the vertices (n,) that share their coordinates with other vertices, in ascending order.

    Also return the group (n,) of each vertex. The index of a group is the position of its lowest vertex in
    the first array.
    """
    points = _to_stored(vertices)
    hashes, repeated = _hash_rows(points.view(np.uint32))
    bucket = np.zeros(1 << 20, bool)  # This filter rejects most vertices of typical meshes.
    bucket[repeated >> 12] = True
    rows = np.flatnonzero(bucket[hashes >> 12])
    rows = rows[np.isin(hashes[rows], repeated)]
    labels = _label_exact(points[rows])
    several = np.bincount(labels, minlength=len(rows))[labels] > 1
    return rows[several], (np.cumsum(several) - 1)[labels[several]]


def _hash_rows(
    bits: NDArray[np.uint32], order: NDArray[Any] | None = None
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return a hash of each row of `bits` (V, 3). Also return the hashes that occur more than once.

    `order` selects rows.
    """
    hashes = np.zeros(len(bits), np.uint32)
    for axis in range(3):
        hashes += bits[:, axis]
        hashes *= np.uint32(0x9E3779B1)
        hashes ^= hashes >> 15  # Mix the signs into all bits, so that mirrored points get different hashes.
    hashes = hashes if order is None else hashes[order]
    ordered = np.sort(hashes)
    return hashes, ordered[1:][ordered[1:] == ordered[:-1]]


def _label_exact(points: NDArray[np.float32]) -> NDArray[Any]:
    """For each of the points (V, 3) from `_to_stored`, return the lowest vertex with equal coordinates."""
    bits = points.view(np.uint32)
    order = np.lexsort(bits.T[::-1])
    rows = bits[order]
    differs = np.ones(len(rows), bool)
    differs[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    differs |= np.isnan(points[order]).any(axis=1)
    labels = np.zeros(len(rows), np.int64)
    # The sort is stable, so the first row of each run is the lowest vertex.
    labels[order] = order[np.flatnonzero(differs)][np.cumsum(differs) - 1]
    return labels


def _to_stored(vertices: NDArray[Any]) -> NDArray[np.float32]:
    """Return the vertices (V, 3) as a `.triasset` file stores them.

    A mesh and its asset then have the same result. The vertices are float32 relative to their origin, with +0
    in place of -0. Therefore equal values have equal bits.
    """
    return np.ascontiguousarray(to_local(vertices, find_origin(vertices)) + np.float32(0.0))


def _label_near(vertices: NDArray[Any], distance: float) -> NDArray[Any]:
    """Steps of at most `distance` connect vertices to chains. Return the lowest vertex (V,) in the chain of
    each vertex.
    """
    from scipy.spatial import cKDTree

    with np.errstate(over="ignore"):
        places = vertices.astype(np.float64)
    finite = np.flatnonzero(np.isfinite(places).all(axis=1))
    labels = np.arange(len(vertices))
    if len(finite) == 0:
        return labels
    # Merge coincident vertices first, because n coincident vertices would add n^2 / 2 pairs.
    points, group = np.unique(places[finite], axis=0, return_inverse=True)
    # The search tree squares distances, which must not overflow. Scale coordinates to at most 2. The scale
    # factor is a power of two, so scaling causes no rounding.
    scale = 2.0 ** (math.frexp(float(np.abs(points).max()))[1] - 1)
    reach = min(distance / scale, 8.0)  # The value 8 exceeds every distance between scaled points.
    tree = cKDTree(points / scale)
    pairs = (int(tree.count_neighbors(tree, reach)) - len(points)) // 2
    if pairs > MAX_PAIRS:
        raise MeshError(
            "WELD_DISTANCE",
            f"a weld distance of {distance:g} joins {pairs} pairs of vertices and would collapse the "
            f"mesh; the limit is {MAX_PAIRS}; choose a shorter distance",
        )
    near = tree.query_pairs(reach, output_type="ndarray")
    _, merged = label_components(len(points), near[:, 0], near[:, 1])
    cluster = merged[group.reshape(-1)]
    smallest = np.full(len(points), len(vertices))
    np.minimum.at(smallest, cluster, finite)
    labels[finite] = smallest[cluster]
    return labels
