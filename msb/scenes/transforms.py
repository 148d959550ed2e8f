"""transforms_*.json: cameras of NeRF-Synthetic, and of instant-ngp and nerfstudio, which extend it.

Sources: `bmild/nerf`: load_blender.py; `NVlabs/instant-ngp`: src/nerf_loader.cu; nerfstudio documentation,
Data conventions.
"""

import re
from pathlib import Path, PurePosixPath
from typing import cast

from msb.base.paths import SpelledFiles
from msb.errors import InputError, SceneError
from msb.scenes.camera import Camera
from msb.scenes.checks import Split, check_name, check_size, focal_from_fov
from msb.scenes.image_size import image_size
from msb.scenes.json_node import Node
from msb.scenes.poses import from_opengl

_SPLIT = re.compile(r"transforms_(train|val|test)\.json", re.IGNORECASE)
_IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".webp", ".exr", ".bmp", ".tif", ".tiff"}
_PINHOLE_MODELS = {"PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "FULL_OPENCV", "SIMPLE_RADIAL", "RADIAL"}
_DISTORTIONS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


def read(root: Node) -> list[Camera]:
    """Return a camera for each frame, in the file's order.

    `split` is set if the file is called transforms_train.json, _val or _test.
    """
    path = root.source.path
    match = _SPLIT.fullmatch(path.name)
    split = cast("Split", match[1].lower()) if match else None
    files = SpelledFiles(path.parent)
    return [_camera(root, frame, files, split) for frame in root["frames"].items()]


def _camera(root: Node, frame: Node, files: SpelledFiles, split: Split | None) -> Camera:
    """Return the camera of one frame; its keys take precedence over the same keys of the document."""

    def find(key: str) -> Node | None:
        return frame.get(key) or root.get(key)

    def number(key: str) -> float | None:
        node = find(key)
        return None if node is None else node.number()

    def focal(axis: str, side: int) -> float | None:
        angle = number(f"camera_angle_{axis}")
        of_angle = None if angle is None else focal_from_fov(angle, side, f"camera_angle_{axis}")
        return of_angle if (given := number(f"fl_{axis}")) is None else given

    _check_distortion(find("camera_model"), find("is_fisheye"), [find(key) for key in _DISTORTIONS])
    with frame["file_path"].locating():
        name = _image_name(frame["file_path"].text())
        check_name(name)
    image = files.find(name)
    width, height = _size(frame, find("w"), find("h"), image)
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
        )


def _check_distortion(model: Node | None, fisheye: Node | None, distortions: list[Node | None]) -> None:
    """Raise CAMERA_DISTORTED for fisheye cameras and lenses with distortion."""
    if model is not None and model.text() not in _PINHOLE_MODELS:
        known = ", ".join(sorted(_PINHOLE_MODELS))
        text = f"the camera model is {model.abbreviated()}; supported without distortion are {known}"
        raise model.error("CAMERA_DISTORTED", text)
    if fisheye is not None and fisheye.value is not False:
        text = f"it is {fisheye.abbreviated()}; only pinhole cameras are supported"
        raise fisheye.error("CAMERA_DISTORTED", text)
    for distortion in distortions:
        if distortion is not None and distortion.number() != 0:
            text = f"it is {distortion.abbreviated()}, a lens distortion; undistort the images"
            raise distortion.error("CAMERA_DISTORTED", text)


def _image_name(path: str) -> str:
    """Return the image's name below the file's folder: without "./", with ".png" if it has no suffix."""
    path = re.sub(r"^(?:\./)++", "", path)
    return path if PurePosixPath(path).suffix.lower() in _IMAGE_SUFFIXES else f"{path}.png"


def _size(frame: Node, width: Node | None, height: Node | None, image: Path) -> tuple[int, int]:
    """Return the recorded size or, if it is missing, the size of the image file."""
    if width is not None and height is not None:
        with width.locating():
            return check_size((width.whole(), height.whole()))
    try:
        return image_size(image)
    except (InputError, SceneError) as error:
        text = f"the image size is missing; set w and h, or add the image ({image.name}: {error.message})"
        raise frame.error("CAMERA_IMAGE", text) from None
