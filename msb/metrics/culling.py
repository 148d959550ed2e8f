"""Step 0 of the DTU evaluation: remove the mesh outside the masks, and scale it to the laser scans."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.errors import MetricError
from msb.metrics.sampling import mesh_arrays

# Radius of mask dilation in pixels, at 1600 x 1200.
DILATION = 24


@dataclass(frozen=True, eq=False)
class CulledMesh:
    """The part of a mesh that remains after culling."""

    # Vertices (V', 3) in DTU's millimetres. Kept vertices without faces are included, because they are
    # samples.
    vertices: NDArray[np.float64]
    # Faces (F', 3) whose three vertices were kept, in the old order.
    faces: NDArray[np.int64]
    # Mask (V,) of the old vertices that were kept.
    kept: NDArray[np.bool_]


def cull_dtu(
    vertices: ArrayLike,
    faces: ArrayLike,
    world_mats: Iterable[ArrayLike],
    scale_mats: Iterable[ArrayLike],
    masks: Iterable[ArrayLike],
    *,
    dilation: float = DILATION,
) -> CulledMesh:
    """Return the part of a mesh that lies in the dilated masks of all views, in DTU's world.

    A view keeps two kinds of vertices: vertices that project outside the image, and vertices whose nearest
    pixel is in the mask dilated by `dilation` pixels. A vertex is kept only if all views keep it. Depth is
    not tested, as in the official code. A vertex behind a camera is tested at its mirrored projection.

    The vertices (V, 3) are in the normalised frame of cameras.npz, like the COLMAP model and the trained
    asset. A kept vertex x becomes scale_mat_0[0, 0] x + scale_mat_0[:3, 3], in millimetres. `world_mats` and
    `scale_mats` are the matrices world_mat_i and scale_mat_i (4, 4) of cameras.npz, one per view; world @
    scale projects to pixels. Masks (H, W) or (H, W, C) have full size, 1600 x 1200. Values above 0 in the
    first channel mark the object. To save memory, pass a generator that reads one mask at a time.

    Source: `hbb1/2d-gaussian-splatting`: scripts/eval_dtu/evaluate_single_scene.py (`cull_scan`).
    """
    points, corners = mesh_arrays(vertices, faces)
    kept = np.ones(len(points), bool)
    world = [_check_matrix(matrix, "world_mat") for matrix in world_mats]
    scale = [_check_matrix(matrix, "scale_mat") for matrix in scale_mats]
    if not world or len(world) != len(scale):
        raise _input_error(
            f"{len(world)} world_mat and {len(scale)} scale_mat were given; each view needs both"
        )
    views = 0
    for mask in masks:
        if views < len(world):
            kept &= _test_view(points, world[views] @ scale[views], _check_mask(mask, views), dilation)
        views += 1
    if views != len(world):
        raise _input_error(f"{views} masks were given for {len(world)} views; each view needs one")
    number = np.cumsum(kept) - 1
    whole = corners[kept[corners].all(axis=1)]
    return CulledMesh(points[kept] * scale[0][0, 0] + scale[0][:3, 3], number[whole], kept)


def _test_view(
    points: NDArray[np.float64], matrix: NDArray[np.float64], mask: NDArray[np.bool_], dilation: float
) -> NDArray[np.bool_]:
    from scipy.ndimage import distance_transform_edt

    height, width = mask.shape
    # Scale the matrix to K [R | t] with K[2, 2] = 1. The coordinate z is then a depth. Add 1e-6 to avoid
    # division by zero.
    norm = np.linalg.norm(matrix[2, :3])
    sign = np.linalg.det(matrix[:3, :3])
    if not norm > 0 or sign == 0:
        raise _input_error("world_mat @ scale_mat is not a camera projection: it is singular")
    projection = matrix[:3] / (norm * np.sign(sign))
    image = points @ projection[:, :3].T + projection[:, 3]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        place = image[:, :2] / (image[:, 2:] + 1e-6)
        # Scale pixel coordinates to [-1, 1]. Vertices that project outside the image are kept.
        centred = 2 * place / (width - 1, height - 1) - 1
        valid = (np.abs(centred) < 1).all(axis=1)
    wide = distance_transform_edt(~mask) <= dilation if mask.any() else mask
    column, row = np.rint(place[valid]).astype(np.int64).T
    kept: NDArray[np.bool_] = ~valid
    kept[valid] = wide[row, column]
    return kept


def _check_matrix(matrix: ArrayLike, name: str) -> NDArray[np.float64]:
    array = np.asarray(matrix)
    if array.shape != (4, 4) or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise _input_error(f"a {name} has shape {array.shape}; each must be 4 x 4 finite numbers")
    return array.astype(np.float64)


def _check_mask(mask: ArrayLike, view: int) -> NDArray[np.bool_]:
    array = np.asarray(mask)
    if array.ndim == 3 and array.shape[2]:
        array = array[..., 0]
    if array.ndim != 2 or min(array.shape) < 2:
        raise _input_error(f"mask {view} has shape {array.shape}; it must be height x width")
    return np.asarray(array > 0)


def _input_error(message: str) -> MetricError:
    return MetricError("METRIC_DTU", message)
