"""Chamfer distance of the DTU benchmark: accuracy and completeness within the observable volume."""

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.errors import about
from msb.meshes import read_mesh
from msb.metrics.dtu_data import DtuScan, read_dtu_scan
from msb.metrics.identity import Definition
from msb.metrics.sampling import mesh_arrays, sample_surface, thin

# Spacing of the samples and radius of the thinning in mm, as in the benchmark.
DENSITY = 0.2
# Points within this margin of the bounding box are also measured. Margin in mm at the lower corner. The
# margin at the upper corner is twice as wide, as in the official code.
PATCH = 60.0
# Distances of this many mm or more are excluded from the averages. Distances above the limit are excluded
# from the averages. Large distances are not clipped.
MAX_DISTANCE = 20.0
# Number of query points per batch of the neighbour search.
_QUERIES = 1 << 20


def chamfer_dtu(
    mesh_path: str | os.PathLike[str],
    dataset_dir: str | os.PathLike[str],
    scan: int,
    seed: int = 0,
    *,
    max_distance: float = MAX_DISTANCE,
) -> dict[str, Any]:
    """Return the Chamfer distance of a mesh file to a DTU scan, in mm.

    Parameters
    ----------
    mesh_path : path-like
        A mesh file, read as stored by `msb.meshes.read_mesh`. The mesh must be culled and in DTU's
        millimetres (`cull_dtu`).
    dataset_dir : path-like
        The folder that holds Points/stl and ObsMask; see `read_dtu_scan`.
    scan : int
        The scan number in the file names.
    seed : int
        The seed of the shuffle before thinning: `numpy.random.default_rng(seed).shuffle(points, axis=0)`.
    max_distance : float
        Distances of at least this many mm are excluded; the benchmark uses 20.

    Returns
    -------
    dict
        In mm: "mean_d2s" (mesh to scan: accuracy), "mean_s2d" (scan to mesh: completeness) and their average
        "overall". A value that cannot be computed is None, and "reason" explains why. Further keys are
        "scan", "seed", "identity", and the number of points at each stage ("n_...").

    Raises
    ------
    InputError
        FILE_NOT_FOUND, FILE_UNREADABLE or FILE_NOT_RECOGNISED.
    MeshFileError
        A file is not a valid mesh of its format.
    MetricError
        METRIC_MESH or METRIC_DTU.

    Notes
    -----
    Source: `jzhangbs/DTUeval-python`: eval.py, as `hbb1/2d-gaussian-splatting` uses it:
    scripts/eval_dtu/eval.py.
    """
    data = read_dtu_scan(dataset_dir, scan)
    mesh = read_mesh(mesh_path, images=False)
    with about(mesh_path):
        result = chamfer_surface(mesh.vertices, mesh.faces, data, seed, max_distance=max_distance)
    return {**result, "scan": int(scan)}


def chamfer_surface(
    vertices: ArrayLike, faces: ArrayLike, data: DtuScan, seed: int = 0, *, max_distance: float = MAX_DISTANCE
) -> dict[str, Any]:
    """Return the result of `chamfer_dtu` for a mesh of vertices (V, 3), in mm, and faces (F, 3).

    Every vertex is a sample, including vertices without faces. Zero-area faces give no samples.
    """
    generator = np.random.default_rng(seed)
    points, corners = mesh_arrays(vertices, faces)
    samples, proper = sample_surface(points, corners, DENSITY)
    cloud = np.concatenate([points, samples])
    counts = {"n_vertices": len(points), "n_faces_nonzero": proper, "n_sampled": len(cloud)}
    del samples
    generator.shuffle(cloud, axis=0)
    result = chamfer_points(thin(cloud, DENSITY), data, max_distance=max_distance)
    identity = CHAMFER.identity(seed=int(seed), max_distance_mm=float(max_distance))
    return {**result, **counts, "seed": int(seed), "identity": identity.to_dict()}


def chamfer_points(points: ArrayLike, data: DtuScan, *, max_distance: float = MAX_DISTANCE) -> dict[str, Any]:
    """Return the distances in mm between a scan and thinned points (N, 3).

    The result has the keys of `chamfer_dtu` that do not need a mesh.
    """
    cloud, _ = mesh_arrays(points, ())
    low, high = data.box[:1] - np.float32(PATCH), data.box[1:] + np.float32(2 * PATCH)
    # Select the points within the margins of the box and the points in observed voxels. Also select the scan
    # points above the table.
    inside = cloud[((cloud >= low) & (cloud < high)).all(axis=1)]
    voxel = np.around((inside - data.box[:1]) / data.resolution)
    in_grid = ((voxel >= 0) & (voxel < data.observed.shape)).all(axis=1)
    seen = inside[in_grid][data.observed[tuple(voxel[in_grid].astype(np.int64).T)]]
    above = data.points[data.points @ data.plane[:3] + data.plane[3] > 0]

    to_scan = _measure_distances(seen, data.points, max_distance)
    to_mesh = _measure_distances(above, inside, max_distance)
    accuracy, completeness = _average(to_scan), _average(to_mesh)
    overall = None if accuracy is None or completeness is None else (accuracy + completeness) / 2
    return {
        "mean_d2s": accuracy,
        "mean_s2d": completeness,
        "overall": overall,
        "reason": None
        if overall is not None
        else _explain_missing(len(seen), len(above), len(inside), max_distance),
        "n_down": len(cloud),
        "n_inbound": len(inside),
        "n_grid_in": int(np.count_nonzero(in_grid)),
        "n_in_obs": len(seen),
        "n_stl": len(data.points),
        "n_stl_above": len(above),
        "n_d2s_lt_max": len(to_scan),
        "n_s2d_lt_max": len(to_mesh),
        "identity": CHAMFER.identity(max_distance_mm=float(max_distance)).to_dict(),
    }


def _measure_distances(
    queries: NDArray[np.float64], targets: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """For each query, return the distance to the nearest target. Distances of `limit` or more are omitted."""
    from scipy.spatial import cKDTree

    if not len(queries) or not len(targets):
        return np.zeros(0)
    tree = cKDTree(targets)
    parts = []
    for start in range(0, len(queries), _QUERIES):
        # An upper bound makes the search faster for distant queries.
        nearest, _ = tree.query(queries[start : start + _QUERIES], distance_upper_bound=limit, workers=-1)
        parts.append(nearest[nearest < limit])
    return np.concatenate(parts)


def _average(distances: NDArray[np.float64]) -> float | None:
    return float(distances.mean()) if len(distances) else None


def _explain_missing(seen: int, above: int, inside: int, limit: float) -> str:
    if not inside:
        return "no point of the mesh lies within the bounds of the scan"
    if not seen:
        return "no point of the mesh lies in the observed volume"
    if not above:
        return "no point of the scan lies above the table"
    return f"no point of the mesh lies within {limit:g} mm of the scan"


CHAMFER = Definition(
    name="chamfer_dtu",
    unit="mm",
    better="lower",
    parameters={
        "density_mm": 0.2,
        "patch_mm": 60.0,
        "max_distance_mm": 20.0,
        "thinning": "greedy, in shuffled order",
        "generator": "numpy.random.default_rng(seed).shuffle",
    },
    libraries=("numpy", "scipy"),
)
