"""Read transforms_*.json, the camera files of NeRF-Synthetic, instant-ngp and nerfstudio.

Sources: `bmild/nerf`: load_blender.py; `NVlabs/instant-ngp`: src/nerf_loader.cu; nerfstudio documentation,
Data conventions.
"""

import contextlib
import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import cast

from msb.base.paths import SpelledFiles
from msb.errors import InputError, SceneError
from msb.scenes.camera import Camera
from msb.scenes.checks import Split, check_name, check_size, focal_from_fov
from msb.scenes.image_size import IMAGE_SUFFIXES, image_size
from msb.scenes.json_node import Node
from msb.scenes.poses import from_opengl
from msb.scenes.transforms_lens import read_distortion

SPLIT_NAME = re.compile(r"transforms_(train|val|test)\.json", re.IGNORECASE)
# Image suffixes that are kept in names. Any other ending is part of the name, such as ".0001" in
# "frame.0001".
_KEPT_SUFFIXES = {*IMAGE_SUFFIXES, ".exr", ".bmp"}


def read(root: Node) -> list[Camera]:
    """Return a camera for each frame, in the file's order.

    `split` is set if the file is called transforms_train.json, _val or _test.
    """
    path = root.source.path
    match = SPLIT_NAME.fullmatch(path.name)
    split = cast("Split", match[1].lower()) if match else None
    files = SpelledFiles(path.parent)
    usual_size = cache(partial(_first_size, root, files))
    return [_camera(root, frame, files, split, usual_size) for frame in root["frames"].items()]


def _first_size(root: Node, files: SpelledFiles) -> tuple[int, int] | None:
    """Return the size of the first readable image. If no image can be read, return None."""
    for frame in root["frames"].items():
        with contextlib.suppress(InputError, SceneError):
            name = image_name(frame["file_path"].text())
            check_name(name)
            return image_size(files.find(name))
    return None


def _camera(
    root: Node,
    frame: Node,
    files: SpelledFiles,
    split: Split | None,
    usual_size: Callable[[], tuple[int, int] | None],
) -> Camera:
    """Return the camera of one frame. Keys of the frame take precedence over keys of the document."""

    def find(key: str) -> Node | None:
        return frame.get(key) or root.get(key)

    def number(key: str) -> float | None:
        node = find(key)
        return None if node is None else node.number()

    def focal(axis: str, side: int) -> float | None:
        angle = number(f"camera_angle_{axis}")
        of_angle = None if angle is None else focal_from_fov(angle, side, f"camera_angle_{axis}")
        return of_angle if (given := number(f"fl_{axis}")) is None else given

    distortion = read_distortion(find)
    with frame["file_path"].locating():
        name = image_name(frame["file_path"].text())
        check_name(name)
    image = files.find(name)
    width, height = _size(frame, find("w"), find("h"), image, usual_size)
    with frame["transform_matrix"].locating():
        pose = from_opengl(frame["transform_matrix"].array(4, 4), "the camera-to-world matrix")
    with frame.locating():
        fx, fy = focal("x", width), focal("y", height)
        if fx is None:
            text = "the focal length is missing; set fl_x or camera_angle_x (radians) here or in the document"
            raise frame.error("CAMERA_FILE", text)
        # The principal point is in the middle by default.
        cx, cy = number("cx"), number("cy")
        return Camera(
            width,
            height,
            fx,
            fx if fy is None else fy,  # pixels are square by default
            width / 2 if cx is None else cx,
            height / 2 if cy is None else cy,
            pose,
            name,
            image,
            split=split,
            distortion=distortion,
        )


def image_name(path: str) -> str:
    """Return the image's name relative to the file's folder, without "./".

    The suffix ".png" is added to a name without a suffix.
    """
    path = re.sub(r"^(?:\./)++", "", path)
    return path if PurePosixPath(path).suffix.lower() in _KEPT_SUFFIXES else f"{path}.png"


def _size(
    frame: Node,
    width: Node | None,
    height: Node | None,
    image: Path,
    usual_size: Callable[[], tuple[int, int] | None],
) -> tuple[int, int]:
    """Return the recorded size. If the recorded size is missing, return the size of the image file.

    If the file is missing, use another frame's image.
    """
    if width is not None and height is not None:
        with width.locating():
            return check_size((width.whole(), height.whole()))
    try:
        return image_size(image)
    except (InputError, SceneError) as error:
        if error.code == "FILE_NOT_FOUND" and (size := usual_size()) is not None:
            return size
        text = f"the image size is missing; set w and h, or add the image ({image.name}: {error.message})"
        raise frame.error("CAMERA_IMAGE", text) from None
