"""Step 0 of the DTU evaluation: drop parts outside the masks, and scale to the world of the laser scans."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.errors import MetricError
from msb.metrics.sampling import mesh_arrays

# Pixels at 1600 x 1200 by which masks are widened.
DILATION = 24


@dataclass(frozen=True, eq=False)
class CulledMesh:
    """The part of a mesh that culling leaves."""

    # (V', 3), in DTU's millimetres. Kept vertices that no face uses stay, because they are samples.
    vertices: NDArray[np.float64]
    # (F', 3), those whose three vertices were kept, in the old order.
    faces: NDArray[np.int64]
    # (V,), whether each of the old vertices was kept.
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
    """Return the part of a mesh that lies in the widened masks of all views, in DTU's world.

    A vertex is kept by a view if the view's mask, widened by `dilation` pixels, holds the nearest pixel, or
    if it projects outside the image; it stays if all views keep it. There is no test of depth: a vertex
    behind a camera is judged by its mirrored projection, as in upstream.

    The vertices (V, 3) are in the normalised frame of cameras.npz, which is that of COLMAP's model and of the
    trained asset; those returned are scale_mat_0[0, 0] x + scale_mat_0[:3, 3]. `world_mats` and `scale_mats`
    are world_mat_i and scale_mat_i (4, 4) of cameras.npz, one of each per view; world @ scale projects to
    pixels. Masks (H, W) or (H, W, C) are of full size, 1600 x 1200; of several channels the first counts, and
    any value above 0 is object. A generator that reads one file at a time keeps the memory small.

    Source: `hbb1/2d-gaussian-splatting`: scripts/eval_dtu/evaluate_single_scene.py (`cull_scan`).
    """
    points, corners = mesh_arrays(vertices, faces)
    kept = np.ones(len(points), bool)
    world = [_matrix(each, "world_mat") for each in world_mats]
    scale = [_matrix(each, "scale_mat") for each in scale_mats]
    if not world or len(world) != len(scale):
        raise _bad(f"there are {len(world)} world_mat and {len(scale)} scale_mat; each view needs both")
    views = 0
    for mask in masks:
        if views < len(world):
            kept &= _kept_by(points, world[views] @ scale[views], _mask(mask, views), dilation)
        views += 1
    if views != len(world):
        raise _bad(f"there are {views} masks for {len(world)} views; one for each is needed")
    number = np.cumsum(kept) - 1
    whole = corners[kept[corners].all(axis=1)]
    return CulledMesh(points[kept] * scale[0][0, 0] + scale[0][:3, 3], number[whole], kept)


def _kept_by(
    points: NDArray[np.float64], matrix: NDArray[np.float64], mask: NDArray[np.bool_], dilation: float
) -> NDArray[np.bool_]:
    from scipy.ndimage import distance_transform_edt

    height, width = mask.shape
    # Scaled to K [R | t] with K[2, 2] = 1, so that z is a depth and the guard against z = 0 has its size.
    norm = np.linalg.norm(matrix[2, :3])
    sign = np.linalg.det(matrix[:3, :3])
    if not norm > 0 or sign == 0:
        raise _bad("world_mat @ scale_mat is not the projection of a camera: it is singular")
    projection = matrix[:3] / (norm * np.sign(sign))
    image = points @ projection[:, :3].T + projection[:, 3]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        place = image[:, :2] / (image[:, 2:] + 1e-6)
        centred = 2 * place / (width - 1, height - 1) - 1
        valid = (np.abs(centred) < 1).all(axis=1)
    wide = distance_transform_edt(~mask) <= dilation if mask.any() else mask
    column, row = np.rint(place[valid]).astype(np.int64).T
    kept: NDArray[np.bool_] = ~valid
    kept[valid] = wide[row, column]
    return kept


def _matrix(matrix: ArrayLike, name: str) -> NDArray[np.float64]:
    array = np.asarray(matrix)
    if array.shape != (4, 4) or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise _bad(f"a {name} has shape {array.shape}; each must be 4 x 4 finite numbers")
    return array.astype(np.float64)


def _mask(mask: ArrayLike, view: int) -> NDArray[np.bool_]:
    array = np.asarray(mask)
    if array.ndim == 3 and array.shape[2]:
        array = array[..., 0]
    if array.ndim != 2 or min(array.shape) < 2:
        raise _bad(f"mask {view} has shape {array.shape}; it must be height x width")
    return np.asarray(array > 0)


def _bad(message: str) -> MetricError:
    return MetricError("METRIC_DTU", message)
