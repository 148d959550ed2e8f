"""A tiny scene in the layout of each dataset, all of the same pebble: `data_stubs/scenes`."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image
from scipy.io import savemat

from data_stubs.colmap_file import rounded, write_colmap
from data_stubs.photographs import averaged, photograph, to_bytes
from data_stubs.surface import FRONT, Y_DOWN, Surface, pebble, walled
from msb.scenes import Camera

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

VIEWS = 16
POINTS = 400
"""Number of points in a scene's SfM model."""
SCAN_POINTS = 3000
DISTANCE = 4.0
FOV_Y = 0.7

MILLIMETRES = 12.0
"""Millimetres of DTU's world per unit of the normalised frame."""
OFFSET = np.array([5.0, -3.0, 600.0])
VOXEL = 2.0


def front_cameras(
    seed: int, size: tuple[int, int], names: list[str], *, y_down: bool, spread: float = 0.35
) -> list[Camera]:
    """Return cameras on the side of the pebble that faces away from the wall, one for each name."""
    random, turn = np.random.default_rng(seed), Y_DOWN if y_down else np.eye(3)
    cameras = []
    for name in names:
        eye = FRONT + random.uniform(-spread, spread, 3)
        eye *= DISTANCE / np.linalg.norm(eye)
        camera = Camera.look_at(
            turn @ eye,
            (0, 0, 0),
            up=turn @ (0, 0, 1),
            width=size[0],
            height=size[1],
            fov_y=FOV_Y,
            name=name,
        )
        cameras.append(camera)
    return cameras


def write_mipnerf360(folder: Path) -> None:
    """Write Mip-NeRF 360: sparse/0, JPEG photographs, and the same reduced in images_2 and images_4."""
    surface = walled().turned(Y_DOWN)
    cameras = mipnerf360_cameras()
    for camera in cameras:
        image = photograph(surface, camera)[..., :3]
        for name, factor in (("images", 1), ("images_2", 2), ("images_4", 4)):
            write_photograph(folder / name / str(camera.name), averaged(image, factor))
    write_colmap(folder / "sparse" / "0", cameras, *sfm_points(surface))


def mipnerf360_cameras() -> list[Camera]:
    """Return the cameras of the Mip-NeRF 360 stub at full size."""
    return front_cameras(1, (256, 192), [f"DSC{i:05d}.JPG" for i in range(7950, 7950 + VIEWS)], y_down=True)


def write_tanksandtemples(folder: Path) -> None:
    """Write Tanks and Temples as 3DGS packages it: photographs half as large as the recorded cameras."""
    surface = walled().turned(Y_DOWN)
    cameras = tanksandtemples_cameras()
    for camera in cameras:
        write_photograph(folder / "images" / str(camera.name), photograph(surface, camera)[..., :3])
    recorded = [camera.resized(2 * camera.width - 1, 2 * camera.height - 1) for camera in cameras]
    write_colmap(folder / "sparse" / "0", recorded, *sfm_points(surface))


def tanksandtemples_cameras() -> list[Camera]:
    """Return the cameras of the Tanks and Temples stub at the size of its photographs."""
    return front_cameras(2, (112, 80), [f"{i:06d}.jpg" for i in range(1, VIEWS + 1)], y_down=True)


def write_nerf_synthetic(folder: Path) -> None:
    """Write NeRF-Synthetic: RGBA PNG, two JSON files, and depths and normals among the test images."""
    surface = pebble()
    for split, cameras in nerf_synthetic_cameras().items():
        frames = []
        for camera in cameras:
            image = photograph(surface, camera)
            file = folder / f"{camera.name}.png"
            write_photograph(file, image)
            if split == "test":
                for kind in ("depth_0000", "normal_0000"):
                    write_photograph(file.with_name(f"{file.stem}_{kind}.png"), image[::9, ::9])
            matrix = camera.camera_to_world * (1, -1, -1, 1)  # columns: from OpenCV's axes to OpenGL's
            frame = {"file_path": f"./{camera.name}", "rotation": 0.0, "transform_matrix": rounded(matrix)}
            frames.append(frame)
        document = {"camera_angle_x": rounded(cameras[0].fov_x), "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(document, indent=1))


def nerf_synthetic_cameras() -> dict[str, list[Camera]]:
    """Return the cameras of the NeRF-Synthetic stub: all around, above the horizon; a circle for testing."""
    random = np.random.default_rng(3)
    turns = {"train": random.uniform(0, 2 * np.pi, 12), "test": np.arange(4) * np.pi / 2 + 0.3}
    heights = {"train": random.uniform(0.1, 0.9, 12), "test": np.full(4, 0.5)}
    found: dict[str, list[Camera]] = {}
    for split, angles in turns.items():
        found[split] = []
        for index, (angle, height) in enumerate(zip(angles, heights[split], strict=True)):
            flat = DISTANCE * np.sqrt(1 - height**2)
            eye = flat * np.cos(angle), flat * np.sin(angle), DISTANCE * height
            camera = Camera.look_at(eye, (0, 0, 0), up=(0, 0, 1), width=144, height=144, fov_y=FOV_Y)
            found[split].append(replace(camera, name=f"{split}/r_{index}"))
    return found


def write_dtu(folder: Path) -> None:
    """Write DTU as 2DGS packages it: RGBA, masks, cameras.npz, a COLMAP model, and the laser scan."""
    surface, cameras = pebble(), dtu_cameras()
    scan = folder / "scan1"
    scale = np.diag([MILLIMETRES, MILLIMETRES, MILLIMETRES, 1.0])
    scale[:3, 3] = OFFSET
    matrices: dict[str, Any] = {}
    for index, camera in enumerate(cameras):
        image = photograph(surface, camera)
        image[..., :3] += 0.35 * (image[..., 3:] == 0)  # a grey table behind the mask
        write_photograph(scan / "images" / str(camera.name), image)
        mask = np.repeat(255 * (image[..., 3:] >= 0.5), 3, axis=2).astype(np.uint8)
        write_photograph(scan / "mask" / f"{index:03d}.png", mask)
        lens = np.eye(4)
        lens[:3, :3] = camera.K
        matrices[f"world_mat_{index}"] = (lens @ camera.world_to_camera @ np.linalg.inv(scale)).astype("<f4")
        matrices[f"scale_mat_{index}"] = scale.astype("<f4")
    np.savez(scan / "cameras.npz", **matrices)
    write_colmap(scan / "sparse" / "0", cameras, *sfm_points(surface))
    _write_laser_scan(folder, surface)


def dtu_cameras() -> list[Camera]:
    """Return the cameras of the DTU stub."""
    return front_cameras(
        4, (144, 108), [f"{index:04d}.png" for index in range(VIEWS)], y_down=False, spread=0.6
    )


def _write_laser_scan(folder: Path, surface: Surface) -> None:
    points, _ = on_surface(surface, SCAN_POINTS, 5)
    points = points * MILLIMETRES + OFFSET
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (folder / "Points" / "stl").mkdir(parents=True, exist_ok=True)
    (folder / "Points" / "stl" / "stl001_total.ply").write_bytes(
        header.encode() + points.astype("<f4").tobytes()
    )
    low, high = np.floor(points.min(axis=0) - 2), np.ceil(points.max(axis=0) + 2)
    voxels = np.ceil((high - low) / VOXEL).astype(int) + 1
    (folder / "ObsMask").mkdir(exist_ok=True)
    box = np.stack([low, low + VOXEL * (voxels - 1)])
    grid = {"ObsMask": np.ones(voxels, np.uint8), "BB": box, "Res": np.array([[VOXEL]])}
    _write_mat(folder / "ObsMask" / "ObsMask1_10.mat", grid)
    table = {"P": np.array([[0.0], [0.0], [1.0], [-(low[2] + 4)]])}
    _write_mat(folder / "ObsMask" / "Plane1.mat", table)


def _write_mat(path: Path, values: dict[str, NDArray[Any]]) -> None:
    stream = io.BytesIO()
    savemat(stream, values)
    content = bytearray(stream.getvalue())
    content[:116] = b"MATLAB 5.0 MAT-file".ljust(116)  # without the date
    path.write_bytes(content)


def on_surface(surface: Surface, count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (count, 3) spread evenly over the surface, and their colours without sheen."""
    random = np.random.default_rng(seed)
    corners = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = random.choice(len(area), count, p=area / area.sum())
    u, v = np.sqrt(random.random(count)), random.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)[:, None]
    colors = surface.color[surface.faces]
    return (weights @ corners[face])[:, 0], (weights @ colors[face])[:, 0]


def sfm_points(surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return points and colours as a reconstruction finds them."""
    places, colors = on_surface(surface, POINTS, 6)
    return places, to_bytes(colors)


def write_photograph(path: Path, image: NDArray[Any]) -> None:
    """Write an image (H, W, 3 or 4), floats in [0, 1] or bytes, as the suffix says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = image if image.dtype == np.uint8 else to_bytes(image)
    options: dict[str, Any] = {"optimize": True} if path.suffix == ".png" else {"quality": 92}
    Image.fromarray(pixels).save(path, **options)


WRITERS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "mipnerf360": ("mipnerf360/pebble", write_mipnerf360),
    "tanksandtemples": ("tanksandtemples/pebble", write_tanksandtemples),
    "nerf_synthetic": ("nerf_synthetic/pebble", write_nerf_synthetic),
    "dtu": ("dtu", write_dtu),
}
"""Dataset -> its folder below data_stubs/scenes, and the function that writes it."""
