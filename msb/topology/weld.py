"""Merge coincident vertices, as an option that runs before an audit and is reported beside it."""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshError
from msb.topology.components import label_components

Weld = Literal["exact"] | float

# Most pairs within the weld distance: 1 GiB of indices. Real welds have about one pair per vertex.
MAX_PAIRS = 1 << 26


def parse_weld(text: str | float) -> Weld:
    """Return the weld setting written as `text`: "exact", or a positive finite length."""
    if text == "exact":
        return "exact"
    try:
        # True is the number 1 to Python, but nobody means a length by it.
        distance = math.nan if isinstance(text, bool | np.bool_) else float(text)
    except (ValueError, TypeError, OverflowError):
        distance = math.nan
    if not (distance > 0 and math.isfinite(distance)):
        raise MeshError("WELD_DISTANCE", f'the weld is "{text}"; it must be exact or a positive length')
    return distance


def weld_vertices(
    vertices: NDArray[Any], faces: NDArray[Any], weld: Weld
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the mesh (V, 3), (F, 3) with coincident vertices merged; all face rows are kept.

    "exact" merges rows whose three float32 coordinates are equal (-0 equals +0, NaN equals nothing); a length
    merges the transitive closure of pairs at most that far apart, so the order does not matter. The first of
    each set of merged vertices stays, in the old order. Rows that collapse become repeated-index rows.
    """
    first, number = merged_vertices(vertices, weld)
    return vertices[first], number.astype(faces.dtype)[faces]


def merged_vertices(vertices: NDArray[Any], weld: Weld) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the first vertex (W,) of each merged set, and the number (V,) of the set each vertex is in.

    The sets are in the order of their first vertices. Raises as `weld_vertices`.
    """
    if len(vertices) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    labels = _exact_labels(vertices) if weld == "exact" else _near_labels(vertices, float(weld))
    _, first, number = np.unique(labels, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def corners_coincide(vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether the exact weld would join any two faces of a soup.

    Positions are hashed to 32 bits and sorted; only those whose hash repeats are compared.
    """
    bits, corners = _as_stored(vertices).view(np.uint32), faces.reshape(-1)
    hashes, repeated = _hashed(bits, corners)
    start, count = 0, 64  # where corners coincide, the first few hashes mostly show it
    while start < len(repeated):
        bucket = np.zeros(1 << 20, bool)
        bucket[repeated[start : start + count] >> 12] = True
        corner = np.flatnonzero(bucket[hashes >> 12])
        rows = np.column_stack([bits[corners[corner]], corner // 3])
        rows = rows[~np.isnan(rows[:, :3].astype(np.uint32).view(np.float32)).any(axis=1)]
        rows = np.unique(rows, axis=0)  # corners of one face that coincide join nothing
        if (rows[1:, :3] == rows[:-1, :3]).all(axis=1).any():
            return True
        start, count = start + count, count << 8
    return False


def coincident_vertices(vertices: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the vertices (n,), ascending, that the exact weld would merge, and which of them each becomes.

    The second array (n,) has a place in the first: that of the smallest vertex of the same coordinates.
    """
    hashes, repeated = _hashed(_as_stored(vertices).view(np.uint32))
    bucket = np.zeros(1 << 20, bool)  # most rows of most meshes go by this
    bucket[repeated >> 12] = True
    rows = np.flatnonzero(bucket[hashes >> 12])
    rows = rows[np.isin(hashes[rows], repeated)]
    labels = _exact_labels(vertices[rows])
    several = np.bincount(labels, minlength=len(rows))[labels] > 1
    return rows[several], (np.cumsum(several) - 1)[labels[several]]


def _hashed(
    bits: NDArray[np.uint32], order: NDArray[Any] | None = None
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return a hash of each row (V, 3), or of those of `order`, and the hashes that occur more than once."""
    hashes = np.zeros(len(bits), np.uint32)
    for axis in range(3):
        hashes += bits[:, axis]
        hashes *= np.uint32(0x9E3779B1)
        hashes ^= hashes >> 15  # else signs would end in the highest bit, and mirrored points be alike
    hashes = hashes if order is None else hashes[order]
    ordered = np.sort(hashes)
    return hashes, ordered[1:][ordered[1:] == ordered[:-1]]


def _exact_labels(vertices: NDArray[Any]) -> NDArray[Any]:
    """Return for each vertex the smallest vertex whose float32 coordinates are the same.

    float32 also for double-precision meshes: that is what an asset made from the mesh holds, and both
    must weld alike.
    """
    points = _as_stored(vertices)
    bits = points.view(np.uint32)
    order = np.lexsort(bits.T[::-1])
    rows = bits[order]
    differs = np.ones(len(rows), bool)
    differs[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    differs |= np.isnan(points[order]).any(axis=1)
    labels = np.zeros(len(rows), np.int64)
    # lexsort is stable, so the first row of each run is the smallest vertex.
    labels[order] = order[np.flatnonzero(differs)][np.cumsum(differs) - 1]
    return labels


def _as_stored(vertices: NDArray[Any]) -> NDArray[np.float32]:
    """Return the vertices (V, 3) as an asset holds them; equal numbers have equal bits."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(vertices.astype(np.float32) + np.float32(0.0))  # -0 becomes +0


def _near_labels(vertices: NDArray[Any], distance: float) -> NDArray[Any]:
    """Return for each vertex the smallest vertex it is joined to by steps of at most `distance`."""
    from scipy.spatial import cKDTree

    with np.errstate(over="ignore"):
        places = vertices.astype(np.float64)
    finite = np.flatnonzero(np.isfinite(places).all(axis=1))
    labels = np.arange(len(vertices))
    if len(finite) == 0:
        return labels
    # Coincident vertices first: they alone could make the number of pairs quadratic.
    points, group = np.unique(places[finite], axis=0, return_inverse=True)
    # The tree squares distances: bring coordinates to at most 2, by a power of two, which rounds nothing.
    scale = 2.0 ** (math.frexp(float(np.abs(points).max()))[1] - 1)
    reach = min(distance / scale, 8.0)  # more than any distance then
    tree = cKDTree(points / scale)
    pairs = (int(tree.count_neighbors(tree, reach)) - len(points)) // 2
    if pairs > MAX_PAIRS:
        raise MeshError(
            "WELD_DISTANCE",
            f"a weld distance of {distance:g} joins {pairs} pairs of vertices, which would collapse the "
            f"mesh; at most {MAX_PAIRS} are joined, so choose a shorter distance",
        )
    near = tree.query_pairs(reach, output_type="ndarray")
    _, merged = label_components(len(points), near[:, 0], near[:, 1])
    cluster = merged[group.reshape(-1)]
    smallest = np.full(len(points), len(vertices))
    np.minimum.at(smallest, cluster, finite)
    labels[finite] = smallest[cluster]
    return labels
