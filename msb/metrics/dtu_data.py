"""The official DTU evaluation data: laser-scanned points, the observed volume and the table plane."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.files import is_folder, library_reason, regular_file
from msb.base.paths import given_path
from msb.errors import InputError, MetricError
from msb.meshes import read_mesh
from msb.metrics.matlab import find_variables

# Maximum number of voxels. All published scans have fewer voxels. Zeros are compressed a thousandfold.
# Therefore a small file can declare an array that exhausts the memory.
_MAX_VOXELS = 1 << 29
# Largest absolute value in a file. The values of real scans are far smaller. Computations with values up to
# this limit do not overflow.
_LARGEST = 1e30
_SHAPES = {"BB": (2, 3), "Res": (1, 1), "P": (4, 1)}


@dataclass(frozen=True, eq=False)
class DtuScan:
    """The evaluation data of one scan. Lengths are in millimetres."""

    # Points (N, 3) of the laser scan.
    points: NDArray[np.float64]
    # Mask (X, Y, Z) of the voxels in which a surface could be observed.
    observed: NDArray[np.bool_]
    # Opposite corners (2, 3) of the grid. Voxel (i, j, k) is centred at box[0] + resolution (i, j, k).
    box: NDArray[np.float32]
    # Side length of a voxel in mm.
    resolution: float
    # Plane (4,) of the table. For a point p above the table, dot(plane, (p, 1)) is positive.
    plane: NDArray[np.float64]


def read_dtu_scan(dataset_dir: str | os.PathLike[str], scan: int) -> DtuScan:
    """Return the evaluation data of one scan.

    The folder holds Points/stl/stl{scan:03}_total.ply, ObsMask/ObsMask{scan}_10.mat and
    ObsMask/Plane{scan}.mat, as in SampleSet.zip and Points.zip of the DTU MVS data set (Aanaes et al.,
    Large-Scale Data for Multiple-View Stereopsis, 2016).
    """
    folder = given_path(dataset_dir)
    if not is_folder(folder):
        text = "the folder does not exist; it must hold Points/stl and ObsMask"
        raise InputError("FILE_NOT_FOUND", text, file=folder)
    grid_file = folder / "ObsMask" / f"ObsMask{scan}_10.mat"
    grid = _read_mat(grid_file, ("ObsMask", "BB", "Res"))
    plane = _read_mat(folder / "ObsMask" / f"Plane{scan}.mat", ("P",))["P"]
    resolution = float(grid["Res"][0, 0])
    if not resolution >= 1 / _LARGEST:
        text = f"the side of a voxel (Res) is {resolution}; it must be at least {1 / _LARGEST}"
        raise _file_error(grid_file, text)
    cloud = folder / "Points" / "stl" / f"stl{scan:03d}_total.ply"
    points = read_mesh(cloud, images=False).vertices.astype(np.float64, copy=False)
    _check_numbers(cloud, "a coordinate", points)
    # use float32 as the official code does, because rounding affects points at the border of the box
    box = np.asarray(grid["BB"], np.float32)
    return DtuScan(points, grid["ObsMask"] != 0, box, resolution, np.asarray(plane, np.float64).ravel())


def _read_mat(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Return the named arrays of a MATLAB 5 file, after checking their sizes before decompression."""
    place = regular_file(path)
    try:
        variables = find_variables(place.read_bytes())
        for name in names:
            _check_shape(place, name, variables[name].shape if name in variables else None)
        arrays = {name: variables[name].read() for name in names}
    except MetricError:
        raise
    except Exception as error:  # a damaged file can raise any exception
        text = f"it cannot be read as a MATLAB 5 file: {library_reason(error)}"
        raise _file_error(place, text) from error
    for name, array in arrays.items():
        if name != "ObsMask":
            _check_numbers(place, name, array)
    return arrays


def _check_numbers(path: Path, what: str, array: NDArray[Any]) -> None:
    if not (np.isfinite(array).all() and np.abs(array).max(initial=0) <= _LARGEST):
        raise _file_error(path, f"{what} is not a finite number between {-_LARGEST} and {_LARGEST}")


def _check_shape(path: Path, name: str, shape: tuple[int, ...] | None) -> None:
    if shape is None:
        raise _file_error(path, f"the variable {name} is missing")
    if name == "ObsMask":
        valid = len(shape) == 3 and min(shape) > 0 and np.prod(shape, dtype=float) <= _MAX_VOXELS
        required = f"three axes and at most {_MAX_VOXELS} voxels"
    else:
        valid = shape == _SHAPES[name]
        required = " x ".join(map(str, _SHAPES[name]))
    if not valid:
        raise _file_error(path, f"{name} has shape {' x '.join(map(str, shape))}; it must have {required}")


def _file_error(path: Path, message: str) -> MetricError:
    return MetricError("METRIC_DTU", message, file=path)
