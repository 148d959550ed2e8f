"""Properties of single faces: area, zero or non-finite area, and duplicates."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Faces per batch. The corners of a batch take 19 MB (nine doubles each).
_CHUNK = 1 << 18
# Number of faces per batch when volumes are computed.
_VOLUMES_AT_ONCE = 1 << 15


def face_areas(vertices: NDArray[Any], faces: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the area (F,) of each face in squared length units. Also return whether the area is finite (F,).

    The area is half the norm of the cross product in double precision. An area that is not finite becomes 0.
    """
    area = np.zeros(len(faces))
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        for start in range(0, len(faces), _CHUNK):
            corners = vertices[faces[start : start + _CHUNK]].astype(np.float64)
            first = corners[:, 0]
            # This explicit sum has a fixed order, so that the kernels give bit-identical areas.
            x, y, z = np.cross(corners[:, 1] - first, corners[:, 2] - first).T
            area[start : start + _CHUNK] = 0.5 * np.sqrt(x * x + y * y + z * z)
    finite = np.isfinite(area)
    area[~finite] = 0.0
    return area, finite


def face_vectors(points: NDArray[np.float64], faces: NDArray[Any]) -> NDArray[np.float64]:
    """Return the normals (F, 3) of the faces. The length of a normal is twice the area of the face."""
    corners = points[faces]
    vectors: NDArray[np.float64] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return vectors


def signed_volume(vertices: NDArray[Any], faces: NDArray[np.int64]) -> float:
    """Return the volume of a closed mesh in cubed length units.

    The volume is negative if the mesh is wound inwards.
    """
    return float(signed_volumes(vertices, faces).sum())


def signed_volumes(vertices: NDArray[Any], faces: NDArray[Any]) -> NDArray[np.float64]:
    """Return the signed volume (F,) of a tetrahedron for each face. The tetrahedron connects the face with
    the first corner of the mesh.

    For a closed body, the sum of these volumes is the volume of the body in cubed length units. The volume is
    negative if the body is wound inwards. The first corner lies on the mesh, which keeps rounding errors
    small.
    """
    volumes = np.zeros(len(faces))
    if not len(faces):
        return volumes
    apex = vertices[faces[0, 0]].astype(np.float64)
    x, y, z = (vertices[:, axis].astype(np.float64) - apex[axis] for axis in range(3))
    # Batches are twice as fast if their columns fit into the processor cache.
    for start in range(0, len(faces), _VOLUMES_AT_ONCE):
        rows = slice(start, start + _VOLUMES_AT_ONCE)
        a, b, c = np.ascontiguousarray(faces[rows].T)
        u, v, w, p, q, r = x[b], y[b], z[b], x[c], y[c], z[c]
        volumes[rows] = (x[a] * (v * r - w * q) + y[a] * (w * p - u * r) + z[a] * (u * q - v * p)) / 6
    return volumes


def sum_areas(area: NDArray[np.float64], group: NDArray[Any], groups: int) -> NDArray[np.float64]:
    """Return the area (groups,) of each group of faces.

    The argument `area` (F,) must not be negative. The argument `group` (F,) is the group of each face.
    Rounding is monotone. The areas are added in face order, so the area of a group never exceeds the area of
    all faces. If all other faces have zero area, the area of the group equals the area of all faces.
    """
    return np.bincount(group, weights=area, minlength=groups).astype(np.float64)


def has_no_area(
    area: NDArray[np.float64], finite: NDArray[np.bool_], repeated: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return a mask (F,) of the faces with three distinct indices and an area of exactly 0."""
    return np.asarray((area == 0) & finite & ~repeated)


def names_vertex_twice(faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which rows of `faces` (F, 3) have a repeated index.

    Rows with a repeated index have no edges and no area.
    """
    a, b, c = faces.T
    return np.asarray((a == b) | (b == c) | (a == c))


def find_duplicate_faces(faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which faces (F,) repeat an earlier face. Such faces have the same three indices in any order or
    winding.

    The first face of each set of duplicates is not marked. Takes O(F log F) time.
    """
    extra = np.zeros(len(faces), bool)
    if len(faces) < 2:
        return extra
    low, high = faces.min(axis=1), faces.max(axis=1)
    # The middle index is the sum minus the lowest and the highest index. The sum of the indices may overflow,
    # but the subtraction then wraps back to the right value.
    middle = faces[:, 0] + faces[:, 1] + faces[:, 2] - low - high
    order = np.lexsort((high, middle, low))  # The sort is stable, so equal rows stay in ascending order
    same = np.ones(len(faces) - 1, bool)
    for column in (low, middle, high):
        sorted_column = column[order]
        same &= sorted_column[1:] == sorted_column[:-1]
    extra[order[1:][same]] = True
    return extra


# Maximum number of faces that xatlas cuts into charts in one call. The time of xatlas grows with the square
# of this number. 48,000 faces took 23 s in one block, and 5 s in blocks of this size. xatlas crashed on a
# sphere of 81,920 faces.
UNWRAP_FACES = 8192


def split_into_blocks(centers: NDArray[Any], most: int) -> list[NDArray[Any]]:
    """Divide the faces into compact blocks by their centres (F, 3). A block contains the indices of at most
    `most` faces."""
    blocks = [np.arange(len(centers))]
    while len(blocks[0]) > most:
        halves = []
        for block in blocks:
            longest = np.ptp(centers[block], axis=0).argmax()
            ordered = block[np.argsort(centers[block, longest], kind="stable")]
            halves += [np.sort(half) for half in np.array_split(ordered, 2)]
        blocks = halves
    return blocks
