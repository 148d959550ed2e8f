"""Read cameras.npz, the projection matrices of a DTU scan in the packages of IDR and NeuS.

Source: `lioryariv/idr`: code/utils/rend_util.py (`load_K_Rt_from_P`), as used by `Totoro97/NeuS` and 2DGS.
"""

import contextlib
import io
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.image_size import image_size
from msb.scenes.source import Source

MATRICES = "cameras.npz"
# Maximum size in bytes of a file that contains a 4 x 4 matrix. Real files contain a few hundred bytes.
# Checked before decompression.
_MAX_MEMBER = 4096
# Largest number of views that are read. Scans of DTU have 49 or 64 views.
_MAX_VIEWS = 4096


def read_matrices(path: Path) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Return the matrices world_mat_i and scale_mat_i of all views. Each matrix is (4, 4).

    world_mat_i @ scale_mat_i projects points of the normalised frame to pixels. scale_mat_0 transforms the
    normalised frame to DTU's millimetres.
    """
    source = Source.open(path)
    try:
        archive = zipfile.ZipFile(io.BytesIO(bytes(source.data)))
    except Exception:  # damaged files raise various exceptions
        raise _bad(source, "it is not an archive written by numpy.savez") from None
    with archive:
        names = set(archive.namelist())
        count = next((i for i in range(_MAX_VIEWS) if f"world_mat_{i}.npy" not in names), _MAX_VIEWS)
        if not count:
            raise _bad(source, "it does not contain world_mat_0")
        world, scale = (
            [_matrix(source, archive, f"{kind}_{index}") for index in range(count)]
            for kind in ("world_mat", "scale_mat")
        )
    return world, scale


def _matrix(source: Source, archive: zipfile.ZipFile, name: str) -> NDArray[np.float64]:
    """Return one matrix of the npz archive."""
    try:
        info = archive.getinfo(f"{name}.npy")
    except KeyError:
        raise _bad(source, f"it does not contain {name}") from None
    matrix: NDArray[np.float64] | None = None
    # Damaged files raise various exceptions. Files with old headers cause warnings.
    with contextlib.suppress(Exception), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if info.file_size <= _MAX_MEMBER:
            matrix = _numbers(io.BytesIO(archive.read(info)))
    if matrix is None or not np.isfinite(matrix).all():
        raise _bad(source, f"{name} is not 4 x 4 finite numbers")
    return matrix


def _numbers(stream: io.BytesIO) -> NDArray[np.float64] | None:
    """Return the 4 x 4 numbers of a .npy file. The header is checked before memory is allocated."""
    if np.lib.format.read_magic(stream) != (1, 0):
        return None
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    if shape != (4, 4) or dtype.kind not in "fiu":
        return None
    values = np.frombuffer(stream.read(16 * dtype.itemsize), dtype).astype(np.float64)
    return values.reshape(shape, order="F" if by_columns else "C")


def read_neus(path: Path, images: Sequence[Path]) -> list[Camera]:
    """Return a camera for each image. The images are sorted by name. The matrices have the same order as the
    sorted images.

    The cameras are in the normalised frame. The RQ decomposition (world_mat_i scale_mat_i)[:3] = K [R | t]
    gives K and [R | t]. The diagonal of K is positive, and K is divided by K[2, 2]. The skew K[0, 1] of DTU's
    cameras is a few tenths of a pixel. The camera class has no skew, so the skew is dropped.
    """
    world, scale = read_matrices(path)
    source = Source(path, b"")
    if len(images) != len(world):
        text = f"it has {len(world)} views for {len(images)} photographs; the numbers must be equal"
        raise _bad(source, text)
    cameras = []
    for index, image in enumerate(images):
        with source.locating(f"world_mat_{index}"):
            with np.errstate(all="ignore"):  # matrices may overflow, and `decompose` rejects them
                projection = world[index] @ scale[index]
            lens, pose = decompose(projection)
            size = image_size(image)
            focal, middle = lens.diagonal(), lens[:, 2]
            lens_numbers = float(focal[0]), float(focal[1]), float(middle[0]), float(middle[1])
            cameras.append(Camera(*size, *lens_numbers, pose, image.name))
    return cameras


@np.errstate(all="ignore")
def decompose(projection: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the intrinsics (3, 3) and the world-to-camera matrix (4, 4) of a projection to pixels."""
    left, last = projection[:3, :3], projection[:3, 3]
    # Compute the RQ decomposition by means of a QR decomposition. With the exchange matrix J, (J M)^T = Q R
    # gives M = (J R^T J)(J Q^T).
    q, r = np.linalg.qr(left[::-1].T)
    lens, rotation = r.T[::-1, ::-1], q.T[::-1]
    sign = np.sign(np.diag(lens))
    lens, rotation = lens * sign, rotation * sign[:, None]
    if not (np.isfinite(lens).all() and abs(np.linalg.det(left)) > 1e-12 * np.linalg.norm(left) ** 3 > 0):
        raise SceneError("SCENE_LAYOUT", "the projection is singular; it is not the projection of a camera")
    if np.linalg.det(rotation) < 0:  # avoid a mirrored rotation
        rotation, last, left = -rotation, -last, -left
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = rotation @ np.linalg.solve(left, last)
    return lens / lens[2, 2], pose


def _bad(source: Source, message: str) -> SceneError:
    """Return an error about the cameras.npz file."""
    return source.error(
        "SCENE_LAYOUT", f"{message}; it must contain world_mat_i and scale_mat_i of every view"
    )
