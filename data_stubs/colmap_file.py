"""Write COLMAP models in the binary form: cameras.bin, images.bin, points3D.bin.

Layout: `colmap/colmap`: doc/format.rst.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.scenes.poses import quaternion_from_rotation

if TYPE_CHECKING:
    from msb.scenes import Camera

_PINHOLE = 1


def rounded(values: ArrayLike) -> Any:
    """Return the numbers as lists, rounded to 12 decimals.

    The last bits of sines, products and eigenvectors depend on the machine. Rounding keeps the bytes of a
    stub equal.
    """
    return (np.round(values, 12) + 0.0).tolist()


def write_colmap(
    folder: Path,
    cameras: Sequence[Camera],
    xyz: NDArray[Any],
    rgb: NDArray[Any],
) -> None:
    """Write a model with a single PINHOLE camera for all images, and points (N, 3) without tracks.

    The cameras have names and equal intrinsics; `folder` is the scene's sparse/0.
    """
    folder.mkdir(parents=True, exist_ok=True)
    one = cameras[0]
    numbers = rounded([one.fx, one.fy, one.cx, one.cy])
    lens = struct.pack("<QiiQQ4d", 1, 1, _PINHOLE, one.width, one.height, *numbers)
    (folder / "cameras.bin").write_bytes(lens)
    shots = [struct.pack("<Q", len(cameras))]
    for number, camera in enumerate(cameras, 1):
        quaternion = quaternion_from_rotation(camera.world_to_camera[:3, :3])
        quaternion = quaternion if quaternion[0] >= 0 else -quaternion
        pose = rounded([*quaternion, *camera.world_to_camera[:3, 3]])
        shots.append(struct.pack("<i7di", number, *pose, 1))
        shots.append(f"{camera.name}\0".encode() + struct.pack("<Q", 0))
    (folder / "images.bin").write_bytes(b"".join(shots))
    points = [struct.pack("<Q", len(xyz))]
    for number, (place, color) in enumerate(zip(rounded(xyz), rgb.tolist(), strict=True), 1):
        points.append(struct.pack("<Q3d3BdQ", number, *place, *color, 0.5, 0))
    (folder / "points3D.bin").write_bytes(b"".join(points))
