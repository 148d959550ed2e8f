"""Polygons -> triangles."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray


def fan_triangulate(
    corners: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut every polygon into the fan (0, 1, 2), (0, 2, 3), ... around its first corner.

    `corners` (C,) are the vertex numbers of all polygons, one polygon after the other, `counts` (N,) how
    many each has: fewer than three give no triangle. Returned are the triangles (F, 3), in the order of the
    polygons, and the polygon (F,) of each.
    """
    if np.all(counts == 3):
        return corners.reshape(-1, 3), np.arange(len(counts))
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    first = (np.cumsum(counts) - counts)[polygon]
    second = first + 1 + steps(triangles)
    faces = np.zeros((len(polygon), 3), dtype=np.int64)
    for column, place in enumerate((first, second, second + 1)):
        faces[:, column] = corners[place]
    return faces, polygon


def wrong_polygon(
    faces: NDArray[np.int64], polygon: NDArray[np.int64], vertices: int
) -> tuple[int, int] | None:
    """Return the first polygon a triangle of which uses no vertex of 0 to `vertices` - 1, and that index.

    `faces` and `polygon` are what `fan_triangulate` gave.
    """
    if not faces.size or (faces.min() >= 0 and faces.max() < vertices):
        return None
    wrong = (faces < 0) | (faces >= vertices)
    face = int(np.argmax(wrong.any(axis=1)))
    return int(polygon[face]), int(faces[face][wrong[face]][0])


def joined_faces(parts: Iterable[NDArray[np.int64]], counts: Sequence[int]) -> NDArray[np.int64]:
    """Return the faces of parts, each by its own vertices, by those of all, of which each brings `counts`.

    An index that names no vertex of its part comes to name none at all.
    """
    total, base, joined = sum(counts), 0, []
    for faces, own in zip(parts, counts, strict=True):
        beyond = np.where(faces < 0, faces, faces - own + total)
        joined.append(np.where((faces >= 0) & (faces < own), faces + base, beyond))
        base += own
    return np.concatenate(joined)


def steps(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return 0, 1, ..., n - 1 for each n of `counts` (N,), one after the other."""
    total = int(counts.sum())
    return np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
