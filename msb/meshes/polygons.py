"""Split polygons into triangles, and join the faces of several parts."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray


def fan_triangulate(
    corners: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split every polygon into the triangle fan (0, 1, 2), (0, 2, 3), ... around its first corner.

    `corners` (C,) are the vertex indices of all polygons one after the other, `counts` (N,) the number of
    corners of each. Polygons with fewer than three corners are dropped. Return the triangles (F, 3) in the
    order of the polygons, and the polygon (F,) of each triangle.
    """
    if np.all(counts == 3):
        return corners.reshape(-1, 3), np.arange(len(counts))
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    # For each triangle, the places in `corners` of its first and second corner.
    first = (np.cumsum(counts) - counts)[polygon]
    second = first + 1 + concatenate_ranges(triangles)
    faces = np.zeros((len(polygon), 3), dtype=np.int64)
    for column, place in enumerate((first, second, second + 1)):
        faces[:, column] = corners[place]
    return faces, polygon


def find_wrong_polygon(
    faces: NDArray[np.int64], polygon: NDArray[np.int64], vertices: int
) -> tuple[int, int] | None:
    """Return the first polygon with a vertex index outside 0..`vertices` - 1, and that index, or None.

    `faces` (F, 3) and `polygon` (F,) are results of `fan_triangulate`.
    """
    if not faces.size or (faces.min() >= 0 and faces.max() < vertices):
        return None
    wrong = (faces < 0) | (faces >= vertices)
    face = int(np.argmax(wrong.any(axis=1)))
    return int(polygon[face]), int(faces[face][wrong[face]][0])


def join_faces(parts: Iterable[NDArray[np.int64]], counts: Sequence[int]) -> NDArray[np.int64]:
    """Return the concatenated faces of several parts, renumbered for the concatenated vertices.

    `counts` are the numbers of vertices of the parts. An index outside its part stays invalid: it is moved
    outside all vertices.
    """
    total, base, joined = sum(counts), 0, []
    for faces, count in zip(parts, counts, strict=True):
        beyond = np.where(faces < 0, faces, faces - count + total)
        joined.append(np.where((faces >= 0) & (faces < count), faces + base, beyond))
        base += count
    return np.concatenate(joined)


def concatenate_ranges(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the concatenated ranges 0, 1, ..., n - 1 for each n of `counts` (N,)."""
    total = int(counts.sum())
    return np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
