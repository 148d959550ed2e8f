"""Scenes of one world in the layout of every dataset: the shipped scenes, and tiny scenes for tests."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.io import savemat

from data_stubs.colmap_file import rounded, write_colmap
from data_stubs.photographs import averaged, to_bytes
from msb.base.matrices import inverse
from msb.scenes import Camera

DISTANCE = 4.0
FOV_Y = 0.7
FRONT = np.array([0.0, -0.92, 0.39])
"""Direction from the centre of the world to the cameras of forward-facing scenes; z is up."""
Y_DOWN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""The rotation from a world with z up (NeRF-Synthetic) to a world with y down (most COLMAP models)."""

MILLIMETRES = 12.0
"""Millimetres of DTU's world per unit of the normalised frame."""
OFFSET = np.array([5.0, -3.0, 600.0])
VOXEL = 2.0


class Shown(Protocol):
    """Interface of the surfaces in `data_stubs.surface` and `data_stubs.still_life`."""

    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def faces(self) -> NDArray[np.int64]: ...
    @property
    def color(self) -> NDArray[np.float64]: ...
    def turned(self, rotation: NDArray[np.float64]) -> Self: ...


@dataclass(frozen=True)
class World:
    """The surface of the scenes, and the size and quality of their photographs.

    Attributes
    ----------
    name : str
        Name of all scenes except DTU's.
    alone, inside : callable
        Return the surface, z up: alone for masked scenes, or with a background that fills every pixel.
    photograph : callable
        Surface and camera -> (H, W, 4) in [0, 1]: colour without premultiplied alpha, and coverage.
    views : int
        Number of cameras of scenes with a COLMAP model. Every eighth camera is a test view.
    around : mapping
        "train" and "test" -> number of cameras in scenes with stored splits.
    sizes : mapping
        Dataset -> (width, height) of its photographs.
    reduced : mapping
        Folder of Mip-NeRF 360's photographs -> reduction factor relative to `sizes`.
    quality : int
        Quality of JPEG photographs.
    levels : int
        Levels per channel in PNG photographs; fewer than 256 give smaller files.
    points, scanned : int
        Number of points of an SfM model, and of DTU's laser scan.
    """

    name: str
    alone: Callable[[], Any]
    inside: Callable[[], Any]
    photograph: Callable[[Any, Camera], NDArray[np.float64]]
    views: int
    around: Mapping[str, int]
    sizes: Mapping[str, tuple[int, int]]
    reduced: Mapping[str, int]
    quality: int
    levels: int
    points: int
    scanned: int


def front_cameras(
    seed: int, size: tuple[int, int], names: list[str], *, y_down: bool, spread: float = 0.35
) -> list[Camera]:
    """Return forward-facing cameras that look at the centre of the world, one per name."""
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


def write_mipnerf360(world: World, folder: Path) -> None:
    """Write Mip-NeRF 360: sparse/0, and JPEG photographs in folders of several sizes."""
    surface = world.inside().turned(Y_DOWN)
    cameras = mipnerf360_cameras(world)
    for camera in cameras:
        image = world.photograph(surface, camera)[..., :3]
        for name, factor in world.reduced.items():
            write_photograph(folder / name / str(camera.name), averaged(image, factor), world.quality)
    write_colmap(folder / "sparse" / "0", cameras, *sfm_points(surface, cameras, world.points))


def mipnerf360_cameras(world: World) -> list[Camera]:
    """Return the cameras of the Mip-NeRF 360 stub at full size."""
    names = [f"DSC{i:05d}.JPG" for i in range(7950, 7950 + world.views)]
    return front_cameras(1, world.sizes["mipnerf360"], names, y_down=True)


def write_tanksandtemples(world: World, folder: Path) -> None:
    """Write Tanks and Temples as 3DGS packages it: the photographs have half the recorded camera size."""
    surface = world.inside().turned(Y_DOWN)
    cameras = tanksandtemples_cameras(world)
    for camera in cameras:
        image = world.photograph(surface, camera)[..., :3]
        write_photograph(folder / "images" / str(camera.name), image, world.quality)
    recorded = [camera.resized(2 * camera.width - 1, 2 * camera.height - 1) for camera in cameras]
    write_colmap(folder / "sparse" / "0", recorded, *sfm_points(surface, cameras, world.points))


def tanksandtemples_cameras(world: World) -> list[Camera]:
    """Return the cameras of the Tanks and Temples stub at the size of its photographs."""
    names = [f"{i:06d}.jpg" for i in range(1, world.views + 1)]
    return front_cameras(2, world.sizes["tanksandtemples"], names, y_down=True)


def write_nerf_synthetic(world: World, folder: Path) -> None:
    """Write NeRF-Synthetic: RGBA PNG files, two JSON files, and depths and normals among the test images."""
    surface = world.alone()
    for split, cameras in nerf_synthetic_cameras(world).items():
        frames = []
        for camera in cameras:
            image = world.photograph(surface, camera)
            file = folder / f"{camera.name}.png"
            write_photograph(file, coarse(image, world.levels))
            if split == "test":
                for kind in ("depth_0000", "normal_0000"):
                    write_photograph(file.with_name(f"{file.stem}_{kind}.png"), image[::9, ::9])
            matrix = camera.camera_to_world * (1, -1, -1, 1)  # columns: from OpenCV's axes to OpenGL's
            frame = {"file_path": f"./{camera.name}", "rotation": 0.0, "transform_matrix": rounded(matrix)}
            frames.append(frame)
        document = {"camera_angle_x": rounded(cameras[0].fov_x), "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(document, indent=1))


def nerf_synthetic_cameras(world: World) -> dict[str, list[Camera]]:
    """Return the cameras of the NeRF-Synthetic stub: all above the horizon; test cameras form a circle."""
    random = np.random.default_rng(3)
    train, test = world.around["train"], world.around["test"]
    turns = {"train": random.uniform(0, 2 * np.pi, train), "test": np.arange(test) * 2 * np.pi / test + 0.3}
    heights = {"train": random.uniform(0.1, 0.9, train), "test": np.full(test, 0.5)}
    width, height_in_pixels = world.sizes["nerf_synthetic"]
    found: dict[str, list[Camera]] = {}
    for split, angles in turns.items():
        found[split] = []
        for index, (angle, height) in enumerate(zip(angles, heights[split], strict=True)):
            flat = DISTANCE * np.sqrt(1 - height**2)
            eye = flat * np.cos(angle), flat * np.sin(angle), DISTANCE * height
            camera = Camera.look_at(
                eye, (0, 0, 0), up=(0, 0, 1), width=width, height=height_in_pixels, fov_y=FOV_Y
            )
            found[split].append(replace(camera, name=f"{split}/r_{index}"))
    return found


def write_dtu(world: World, folder: Path) -> None:
    """Write DTU as 2DGS packages it: RGBA images, masks, cameras.npz, a COLMAP model, and the laser scan."""
    surface, cameras = world.alone(), dtu_cameras(world)
    scan = folder / "scan1"
    scale = np.diag([MILLIMETRES, MILLIMETRES, MILLIMETRES, 1.0])
    scale[:3, 3] = OFFSET
    matrices: dict[str, Any] = {}
    for index, camera in enumerate(cameras):
        image = world.photograph(surface, camera)
        # outside of the mask the photograph shows a grey table
        image[..., :3] += 0.35 * (image[..., 3:] == 0)
        write_photograph(scan / "images" / str(camera.name), coarse(image, world.levels))
        mask = np.repeat(255 * (image[..., 3:] >= 0.5), 3, axis=2).astype(np.uint8)
        write_photograph(scan / "mask" / f"{index:03d}.png", mask)
        lens = np.eye(4)
        lens[:3, :3] = camera.K
        matrices[f"world_mat_{index}"] = (lens @ camera.world_to_camera @ inverse(scale)).astype("<f4")
        matrices[f"scale_mat_{index}"] = scale.astype("<f4")
    np.savez(scan / "cameras.npz", **matrices)
    write_colmap(scan / "sparse" / "0", cameras, *sfm_points(surface, cameras, world.points))
    _write_laser_scan(folder, surface, world.scanned)


def dtu_cameras(world: World) -> list[Camera]:
    """Return the cameras of the DTU stub."""
    names = [f"{index:04d}.png" for index in range(world.views)]
    return front_cameras(4, world.sizes["dtu"], names, y_down=False, spread=0.6)


def _write_laser_scan(folder: Path, surface: Shown, count: int) -> None:
    points, _ = on_surface(surface, count, 5)
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


def on_surface(
    surface: Shown, count: int, seed: int, density: NDArray[np.float64] | float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (count, 3) on the surface, and their colours without sheen.

    The points are distributed evenly, or by a density per face (F,).
    """
    random = np.random.default_rng(seed)
    corners = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = area * density
    face = random.choice(len(area), count, p=share / share.sum())
    u, v = np.sqrt(random.random(count)), random.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)[:, None]
    colors = surface.color[surface.faces]
    return (weights @ corners[face])[:, 0], (weights @ colors[face])[:, 0]


def sfm_points(
    surface: Shown, cameras: list[Camera], count: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return points and colours as in a reconstruction: denser where the surface is large in the images."""
    middle = surface.vertices[surface.faces].mean(axis=1)
    density = np.mean([((middle - camera.center) ** 2).sum(axis=1) ** -1.0 for camera in cameras], axis=0)
    places, colors = on_surface(surface, count, 6, density)
    return places, to_bytes(colors)


def coarse(image: NDArray[np.float64], levels: int) -> NDArray[np.float64]:
    """Return an image in [0, 1] rounded to this number of levels."""
    return np.round(np.clip(image, 0, 1) * (levels - 1)) / (levels - 1)


def write_photograph(path: Path, image: NDArray[Any], quality: int = 92) -> None:
    """Write an image (H, W, 3 or 4), floats in [0, 1] or bytes, in the format of the suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = image if image.dtype == np.uint8 else to_bytes(image)
    options: dict[str, Any] = {"optimize": True} if path.suffix == ".png" else {"quality": quality}
    Image.fromarray(pixels).save(path, **options)


def write_scenes(world: World, folder: Path) -> None:
    """Write a scene in each layout below `folder`."""
    for dataset, write in WRITERS.items():
        place = folder / place_of(dataset, world)
        place.mkdir(parents=True, exist_ok=True)
        write(world, place)


def place_of(dataset: str, world: World) -> str:
    """Return the folder of a dataset's stub; DTU's scene keeps its official name."""
    return dataset if dataset == "dtu" else f"{dataset}/{world.name}"


WRITERS: dict[str, Callable[[World, Path], None]] = {
    "mipnerf360": write_mipnerf360,
    "tanksandtemples": write_tanksandtemples,
    "nerf_synthetic": write_nerf_synthetic,
    "dtu": write_dtu,
}
"""The function that writes each dataset."""
