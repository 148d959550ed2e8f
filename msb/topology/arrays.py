"""Check that two arrays describe a triangle mesh."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.errors import MeshError, shorten

# Maximum number of vertices. A pair of vertex indices must fit into 64 bits.
MAX_VERTICES = 2**32 - 1
# Maximum number of faces. Corners are numbered 3 f + k, and SciPy labels components with int32.
MAX_FACES = (2**31 - 1) // 3


def mesh_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return `vertices` (V, 3) as floats and `faces` (F, 3) as integers, and check that every index is valid.

    Coordinates keep their precision and may be NaN or infinite. Faces are int32, or int64 if vertex indices
    are too large.
    """
    points = _check_array(vertices, "vertices", "fiu")
    triangles = _check_array(faces, "faces", "iu")
    if points.dtype.kind != "f":
        points = points.astype(np.float64)
    for array, name, limit in ((points, "vertices", MAX_VERTICES), (triangles, "faces", MAX_FACES)):
        if len(array) > limit:
            text = f"{len(array)} {name} are too many; at most {limit} are supported"
            raise MeshError("MESH_ARRAY", text)
    if triangles.size:
        _check_range(triangles, len(points))
    if triangles.dtype == np.uint32 and len(points) < 2**31:  # Assets use uint32, and the top bit is unused.
        triangles = triangles.view(np.int32)
    return points, np.ascontiguousarray(triangles, np.int32 if len(points) < 2**31 else np.int64)


def _check_array(values: ArrayLike, name: str, kinds: str) -> NDArray[Any]:
    if np.ma.is_masked(values):
        text = f"{name} is a masked array; drop or fill its masked rows first"
        raise MeshError("MESH_ARRAY", text)
    try:
        array = np.asarray(values)
    except ValueError as error:
        ragged = "inhomogeneous" in str(error)
        wrong = "has rows of different lengths" if ragged else f"is not an array ({shorten(str(error))})"
        raise MeshError("MESH_ARRAY", f"{name} {wrong}; it must have shape (n, 3)") from error
    if array.shape in {(0,), (0, 3), (1, 0)}:  # [] or [[]], an array without rows
        return np.zeros((0, 3), np.float64 if "f" in kinds else np.int64)
    if array.ndim != 2 or array.shape[1] != 3:
        text = f"{name} has shape {array.shape}; it must have shape (n, 3)"
        raise MeshError("MESH_ARRAY", text)
    if array.dtype.kind not in kinds:
        required = "real numbers" if "f" in kinds else "integers"
        raise MeshError("MESH_ARRAY", f"{name} has dtype {array.dtype}; it must hold {required}")
    return array


def _check_range(faces: NDArray[Any], vertex_count: int) -> None:
    low, high = int(faces.min()), int(faces.max())
    if low >= 0 and high < vertex_count:
        return
    row = int(np.argmax(((faces < 0) | (faces >= vertex_count)).any(axis=1)))
    bad = next(int(i) for i in faces[row] if not 0 <= i < vertex_count)
    raise MeshError(
        "MESH_INDEX_OUT_OF_RANGE",
        f"face {row} is {tuple(map(int, faces[row]))}: index {bad} is not between 0 and {vertex_count - 1}"
        if vertex_count
        else f"face {row} is {tuple(map(int, faces[row]))}, but the mesh has no vertices",
        pointer=f"faces[{row}]",
    )
