"""Write a capture as a COLMAP scene: pinhole cameras as text, undistorted photographs, masks and points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.base.own_folder import own_folder
from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.datasets.scene import Scene
from msb.scenes.poses import quaternion_from_rotation

if TYPE_CHECKING:
    from msb.scenes.datasets.rules import Size

# Callback that reads the photograph of a view. If a size (height, width) is passed, the callback reads the
# view's mask instead. Images are resampled to the pinhole camera of the view. Photographs are (H, W, 3) or
# (H, W, 4) and masks (H, W, 1), uint8.
ReadPhotograph = Callable[[Scene, Camera], NDArray[np.uint8]]
# Positions (N, 3) and colours (N, 3) of points.
Points = tuple[NDArray[np.float64], NDArray[np.uint8]]
ReadMask = Callable[[Scene, Camera, "Size"], NDArray[np.uint8]]


def write_capture(
    scene: Scene,
    folder: Path,
    points: Points | None,
    read_photograph: ReadPhotograph,
    read_mask: ReadMask,
    step: Callable[[], None],
    *,
    overwrite: bool = False,
) -> None:
    """Write a scene to a new folder. The views of the scene must have the size of their photographs.

    The folder contains `images` with the names of the photographs, and `sparse/0` with PINHOLE cameras and
    `points` as COLMAP text. If a scene has mask files, `masks` is added. If a scene has a recorded split,
    `train_list.txt` and `test_list.txt` are added. Pixels are stored losslessly as PNG. The suffix of a
    photograph's name does not matter. Programs recognise the image type by its content. `step` is called
    after each photograph. If writing fails, no partial folder is left.
    """
    views = sorted((*scene.train, *scene.test), key=lambda view: str(view.name))
    names = _names_below_images([str(view.name) for view in views])
    with own_folder(folder, overwrite=overwrite) as root:
        for view, name in zip(views, names, strict=True):
            pixels = read_photograph(scene, view)
            if pixels.shape[:2] != (view.height, view.width):
                text = f"the photograph of {name} changed while it was read; start the command again"
                raise SceneError("SCENE_IMAGE", text, file=view.image_path)
            _write_png(root / "images" / name, pixels)
            if str(view.name) in scene.masks:
                mask = read_mask(scene, view, pixels.shape[:2])
                _write_png(root / "masks" / f"{name}.png", mask[..., 0])
            step()
        write_model(root / "sparse" / "0", views, names, points)
        if scene.split == "recorded":
            for part, of_part in (("train", scene.train), ("test", scene.test)):
                chosen = {str(view.name) for view in of_part}
                listed = [name for view, name in zip(views, names, strict=True) if view.name in chosen]
                _write_lines(root / f"{part}_list.txt", listed)


def _names_below_images(names: Sequence[str]) -> list[str]:
    """If all names begin with one folder, such as "images", return the names without this folder."""
    first = {PurePosixPath(name).parts[0] for name in names if "/" in name}
    is_shared = len(first) == 1 and all("/" in name for name in names)
    return [name.partition("/")[2] for name in names] if is_shared else list(names)


def write_model(
    folder: Path,
    views: Sequence[Camera],
    names: Sequence[str],
    points: Points | None = None,
) -> None:
    """Write pinhole cameras, and points (N, 3) with colours (N, 3), as a COLMAP model in text format.

    Views with equal sizes and intrinsics share a camera. When written numbers are read again, the float64
    values are the same.
    """
    folder.mkdir(parents=True)
    cameras: dict[tuple[float, ...], int] = {}
    images: list[str] = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then 2D points (none)"]
    for number, (view, name) in enumerate(zip(views, names, strict=True), 1):
        key = (view.width, view.height, view.fx, view.fy, view.cx, view.cy)
        camera = cameras.setdefault(key, len(cameras) + 1)
        pose = view.world_to_camera
        numbers = [*quaternion_from_rotation(pose[:3, :3]).tolist(), *pose[:3, 3].tolist()]
        images += [f"{number} {' '.join(map(repr, numbers))} {camera} {name}", ""]
    lines = [f"{number} PINHOLE {' '.join(map(repr, key))}" for key, number in cameras.items()]
    _write_lines(folder / "cameras.txt", ["# CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY", *lines])
    _write_lines(folder / "images.txt", images)
    xyz, rgb = (np.zeros((0, 3)), np.zeros((0, 3), np.uint8)) if points is None else points
    rows = zip(xyz.tolist(), rgb.tolist(), strict=True)
    lines = [f"{n} {' '.join(map(repr, p))} {' '.join(map(str, c))} 0" for n, (p, c) in enumerate(rows, 1)]
    _write_lines(folder / "points3D.txt", ["# POINT3D_ID X Y Z R G B ERROR, without tracks", *lines])


def _write_lines(file: Path, lines: Iterable[str]) -> None:
    file.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")


def _write_png(file: Path, pixels: NDArray[np.uint8]) -> None:
    from PIL import Image

    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(file, "PNG", compress_level=4)
