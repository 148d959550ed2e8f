"""Properties of single faces: the area, and whether a face has none, is not finite, or is a duplicate."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Number of faces whose corners are gathered together; nine doubles each make 19 MB.
_CHUNK = 1 << 18


def face_areas(vertices: NDArray[Any], faces: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the area (F,) of each face, in squared length units, and whether it is finite.

    It is half the norm of the cross product, in double precision; 0 where that is not finite.
    """
    area = np.zeros(len(faces))
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        for start in range(0, len(faces), _CHUNK):
            corners = vertices[faces[start : start + _CHUNK]].astype(np.float64)
            first = corners[:, 0]
            # Written out, as NumPy may sum in any order: the kernels' areas are the same to the last bit.
            x, y, z = np.cross(corners[:, 1] - first, corners[:, 2] - first).T
            area[start : start + _CHUNK] = 0.5 * np.sqrt(x * x + y * y + z * z)
    finite = np.isfinite(area)
    area[~finite] = 0.0
    return area, finite


def signed_volume(vertices: NDArray[Any], faces: NDArray[np.int64]) -> float:
    """Return the volume that a closed mesh encloses, negative where it is wound inwards.

    The sum of the tetrahedra between the faces and one point; a corner of the mesh, to keep rounding small.
    """
    if not len(faces):
        return 0.0
    corners = vertices[faces].astype(np.float64) - vertices[faces[0, 0]].astype(np.float64)
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def added_areas(area: NDArray[np.float64], group: NDArray[Any], groups: int) -> NDArray[np.float64]:
    """Return the (groups,) area of each group of faces, each added in the order of the faces.

    Rounding is monotone. If areas, which are not negative, are added in one order, the sum over some of the
    faces is never larger than the sum over all of them, and is equal to it if the others have no area.
    """
    return np.bincount(group, weights=area, minlength=groups).astype(np.float64)


def has_no_area(
    area: NDArray[np.float64], finite: NDArray[np.bool_], repeated: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return a mask (F,) of the faces with three distinct indices and an area of exactly 0."""
    return np.asarray((area == 0) & finite & ~repeated)


def names_vertex_twice(faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which (F, 3) rows name a vertex twice; such a row has no edges and no area."""
    a, b, c = faces.T
    return np.asarray((a == b) | (b == c) | (a == c))


def extra_duplicates(faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which faces repeat an earlier one: the same three indices, in any order or winding.

    O(F log F) time. The first face of each set of duplicates is not marked.
    """
    extra = np.zeros(len(faces), bool)
    if len(faces) < 2:
        return extra
    low, high = faces.min(axis=1), faces.max(axis=1)
    # The middle one is what the outer two leave over; exact, because integers wrap consistently.
    middle = faces[:, 0] + faces[:, 1] + faces[:, 2] - low - high
    order = np.lexsort((high, middle, low))  # stable: equal rows stay in ascending order
    same = np.ones(len(faces) - 1, bool)
    for column in (low, middle, high):
        sorted_column = column[order]
        same &= sorted_column[1:] == sorted_column[:-1]
    extra[order[1:][same]] = True
    return extra
