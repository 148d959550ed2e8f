"""Cameras, and camera files in every format. The files are written without the package's writers."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera
from msb.scenes.colmap_models import MODELS
from tests.corpus import forge

Files = dict[str, bytes]
"""The content of each file, by its path below a folder."""
Bad = tuple[Files, str, str]
"""Files, the path to read, and the code of the error."""


def write(folder: Path, files: Files) -> Path:
    """Write the files below `folder` and return it."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def quaternion(seed: int) -> NDArray[np.float64]:
    """Return a unit quaternion (w, x, y, z) with w > 0."""
    q = np.random.default_rng(seed).normal(size=4)
    return q / np.linalg.norm(q) * np.sign(q[0])


def rotation(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation matrix of a unit quaternion q; its columns are the rotated axes q v q*."""

    def multiply(a: Any, b: Any) -> Any:
        return np.array(
            [
                a[0] * b[0] - a[1:] @ b[1:],
                *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])),
            ]
        )

    conjugate = q * (1, -1, -1, -1)
    axes = [multiply(multiply(q, np.array([0.0, *axis])), conjugate)[1:] for axis in np.eye(3)]
    return np.stack(axes, axis=1)


def pose(seed: int) -> NDArray[np.float64]:
    """Return a world-to-camera matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(quaternion(seed))
    matrix[:3, 3] = np.random.default_rng(seed + 1000).normal(size=3)
    return matrix


def some_cameras(count: int = 3, *, centered: bool = False) -> list[Camera]:
    """Return cameras of different sizes and intrinsics."""
    cameras = [
        Camera(
            40 + index,
            30 + 2 * index,
            50.25 + index,
            49.5 + index / 3,
            20.125 + index / 7,
            15.5 - index,
            pose(index),
            f"part/view_{index}.png",
        )
        for index in range(count)
    ]
    return [camera.centered() for camera in cameras] if centered else cameras


# --- COLMAP


def lens_bin(
    number: int = 1,
    model: int = 1,
    width: int = 40,
    height: int = 30,
    parameters: Sequence[float] = (50, 49, 20, 15),
) -> bytes:
    return struct.pack("<iiQQ", number, model, width, height) + struct.pack(
        f"<{len(parameters)}d", *parameters
    )


def shot_bin(
    number: int = 1,
    q: Sequence[float] = (1, 0, 0, 0),
    t: Sequence[float] = (0, 0, 0),
    lens: int = 1,
    name: bytes = b"a.png\0",
    points: int = 0,
    count: int | None = None,
) -> bytes:
    points_2d = struct.pack("<ddq", 1.5, 2.5, -1) * points
    return (
        struct.pack("<i4d3di", number, *q, *t, lens)
        + name
        + struct.pack("<Q", points if count is None else count)
        + points_2d
    )


def point_bin(
    number: int = 7,
    xyz: Sequence[float] = (1, 2, 3),
    rgb: Sequence[int] = (4, 5, 6),
    track: int = 0,
    declared: int | None = None,
) -> bytes:
    count = track if declared is None else declared
    return struct.pack("<Q3d3BdQ", number, *xyz, *rgb, 0.5, count) + b"\1\0\0\0\2\0\0\0" * track


def many(*records: bytes, count: int | None = None) -> bytes:
    """Return a binary file of records; `count` overrides the count in its header."""
    return struct.pack("<Q", len(records) if count is None else count) + b"".join(records)


def colmap_bin(cameras: Sequence[Camera]) -> Files:
    lenses, shots = [], []
    for index, camera in enumerate(cameras):
        parameters = camera.fx, camera.fy, camera.cx, camera.cy
        lenses.append(lens_bin(10 + index, 1, camera.width, camera.height, parameters))
        q, t = quaternion(index), camera.world_to_camera[:3, 3]
        shots.append(shot_bin(index, q * 2, t, 10 + index, f"{camera.name}\0".encode(), index))
    return {"cameras.bin": many(*reversed(lenses)), "images.bin": many(*shots)}


def colmap_txt(cameras: Sequence[Camera]) -> Files:
    lenses, shots = ["# Camera list"], ["# Image list", ""]
    for index, camera in enumerate(cameras):
        numbers = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        lenses.append(f"{10 + index} PINHOLE {' '.join(map(repr, numbers))}")
        values = " ".join(repr(float(v)) for v in (*quaternion(index), *camera.world_to_camera[:3, 3]))
        shots += [f"{index} {values} {10 + index} {camera.name}", " ".join(["1.5 2.5 -1"] * index)]
    return {
        "cameras.txt": "\n".join([*lenses, ""]).encode(),
        "images.txt": "\n".join([*shots, ""]).encode(),
    }


def lens_parameters(model: str, distortion: float) -> list[float]:
    """Return parameters of a model: focal lengths 50 and 49, centre (20, 15), equal distortions."""
    kind = MODELS[model]
    return [50.0, 49.0][: kind.focals] + [20.0, 15.0] + [distortion] * kind.distortions


# --- JSON


def dump(value: Any) -> bytes:
    return json.dumps(value).encode()


def transforms(cameras: Sequence[Camera], **top: Any) -> dict[str, Any]:
    """Return a document in nerfstudio's format with the intrinsics in each frame."""
    flip = np.diag([1.0, -1, -1, 1])
    frames = []
    for camera in cameras:
        to_world = camera.camera_to_world @ flip
        frame = {"file_path": f"./{camera.name}", "transform_matrix": to_world.tolist()}
        frame |= {"w": camera.width, "h": float(camera.height), "fl_x": camera.fx, "fl_y": camera.fy}
        frames.append(frame | {"cx": camera.cx, "cy": camera.cy})
    return {"camera_model": "OPENCV", "k1": 0, "frames": frames} | top


def cameras_json(cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    entries = []
    for index, camera in enumerate(cameras):
        to_world = camera.camera_to_world
        entry = {"id": index, "img_name": camera.name, "width": camera.width, "height": camera.height}
        entry |= {"position": to_world[:3, 3].tolist(), "rotation": to_world[:3, :3].tolist()}
        entries.append(entry | {"fy": camera.fy, "fx": camera.fx})
    return entries


def views(cameras: Sequence[Camera], **top: Any) -> dict[str, Any]:
    keys = ("name", "width", "height", "fx", "fy", "cx", "cy")
    entries = [
        {key: getattr(camera, key) for key in keys} | {"world_to_camera": camera.world_to_camera.tolist()}
        for camera in cameras
    ]
    return {"schema": "msb.views/1", "cameras": entries} | top


# --- images


def png(width: int, height: int) -> bytes:
    """Return a black 8-bit grey PNG."""
    return forge.png(width, height, kind=0, rows=b"\0" * (width + 1) * height)


def jpeg(width: int, height: int, *, frame: int = 0xC0, before: bytes = b"") -> bytes:
    """Return the headers of a JPEG image up to its frame header."""
    app0 = b"\xff\xe0\0\x10JFIF\0\1\1\0\0\1\0\1\0\0"
    head = struct.pack(">HBHHB", 11, 8, height, width, 1) + b"\1\x11\0"
    return b"\xff\xd8" + app0 + before + bytes([0xFF, frame]) + head
