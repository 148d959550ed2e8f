"""COLMAP models: a folder with the files cameras, images and points3D, all .bin or all .txt."""

import contextlib
import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from msb.base.files import is_file, is_folder
from msb.base.paths import SpelledFiles
from msb.errors import MsbError, shorten
from msb.scenes import colmap_binary, colmap_text
from msb.scenes.camera import Camera
from msb.scenes.checks import check_name
from msb.scenes.colmap_models import Lens, Shot
from msb.scenes.poses import rotation_from_quaternion
from msb.scenes.source import Source

_Record = TypeVar("_Record", "Lens", "Shot")
# For each suffix of the files, the reader of the format. The binary format is preferred, as in the 3DGS
# family.
_FORMS: dict[str, ModuleType] = {".bin": colmap_binary, ".txt": colmap_text}

# Largest number of cameras of a model. A camera needs about 0.5 kB of memory and 60 microseconds. A malicious
# file can declare a camera in 73 bytes.
MAX_CAMERAS = 1 << 20
# Smallest accepted length of a quaternion. COLMAP writes unit quaternions. The direction of a much shorter
# quaternion would be inexact.
MIN_QUATERNION = 1e-9


def find_model(folder: Path) -> Path | None:
    """Return the folder of a scene's COLMAP model. If the scene has no model, return None.

    The folder itself is searched first, then the numbered models in `sparse`, and then `sparse`. The numbered
    model with the most images is used. COLMAP numbers the models in `sparse`: 0, 1, ... If several models
    have the same number of images, the model with the lowest number is used.
    """
    if _is_model(folder):
        return folder
    if models := list_models(folder):
        return models[0]
    return folder / "sparse" if _is_model(folder / "sparse") else None


def list_models(folder: Path) -> list[Path]:
    """Return the numbered models in the folder `sparse` of a scene.

    The model with the most images comes first.
    """
    try:
        numbered = [child for child in (folder / "sparse").iterdir() if child.name.isascii()]
    except OSError:
        return []
    numbered = [child for child in numbered if child.name.isdigit() and _is_model(child)]
    numbered.sort(key=lambda child: (int(child.name), child.name))
    return sorted(numbered, key=count_images, reverse=True) if len(numbered) > 1 else numbered


def count_images(model: Path) -> int:
    """Return the number of images of a model without reading the images.

    If a file is missing or damaged, the result is 0.
    """
    with contextlib.suppress(MsbError):
        for suffix, form in _FORMS.items():
            if is_file(model / f"images{suffix}"):
                return int(form.count_shots(Source.open(model / f"images{suffix}")))
    return 0


def _is_model(folder: Path) -> bool:
    """Return whether a folder contains a file of a COLMAP model."""
    names = (f"{part}{suffix}" for part in ("cameras", "images", "points3D") for suffix in _FORMS)
    return any(is_file(folder / name) for name in names)


def read_model(folder: Path) -> list[Camera]:
    """Return a camera for each image of the COLMAP model in `folder`, in the file's order.

    The recorded principal point and lens distortion are kept. If the folder is `sparse/0` or `sparse` of a
    scene, `image_path` is a file in the scene's folder `images`.
    """
    suffix = _find_suffix(folder, ("cameras", "images"))
    form = _FORMS[suffix]
    lens_file = Source.open(folder / f"cameras{suffix}")
    shot_file = Source.open(folder / f"images{suffix}")
    lenses = {lens.number: lens for lens in _check_unique("camera", form.read_lenses(lens_file), lens_file)}
    photographs = _image_folder(folder)
    images = None if photographs is None else SpelledFiles(photographs)
    cameras: list[Camera] = []
    for shot in _check_unique("image", form.read_shots(shot_file), shot_file):
        if len(cameras) == MAX_CAMERAS:
            text = f"it has more than {MAX_CAMERAS} images; split the model into parts"
            raise shot_file.error("CAMERA_FILE", text, pointer=shot.pointer)
        cameras.append(_camera(shot, shot_file, lenses, lens_file, images))
    return cameras


def _check_unique(what: str, records: Iterable[_Record], source: Source) -> Iterator[_Record]:
    """Yield the records of a file. A repeated id is an error."""
    seen: set[int] = set()
    for record in records:
        if record.number in seen:
            text = f"{what} id {record.number} occurs twice"
            raise source.error("COLMAP_INVALID", text, pointer=record.pointer)
        seen.add(record.number)
        yield record


def read_points(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the points of a COLMAP model.

    Parameters
    ----------
    path : str or Path
        The path of points3D.bin or points3D.txt, or the folder that contains one of these files (.bin is
        preferred), or a scene's folder with `sparse/0` or `sparse`.

    Returns
    -------
    xyz : (N, 3) float64
        The points in the world, in the file's order.
    rgb : (N, 3) uint8
        Colours as photographed.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        COLMAP_FILE_MISSING or COLMAP_INVALID.

    Notes
    -----
    Time and memory are linear in the file's size, even if the file declares more records.
    """
    file = Path(path)
    if is_folder(file):
        folder = find_model(file) or file
        file = folder / f"points3D{_find_suffix(folder, ('points3D',))}"
    form = _FORMS[".txt" if file.suffix.lower() == ".txt" else ".bin"]
    points: tuple[NDArray[np.float64], NDArray[np.uint8]] = form.read_points(Source.open(file))
    return points


def _find_suffix(folder: Path, parts: tuple[str, ...]) -> str:
    """If the folder contains all files `parts` in one format, return the suffix of this format."""
    for suffix in _FORMS:
        if all(is_file(folder / f"{part}{suffix}") for part in parts):
            return suffix
    files = " or ".join(" and ".join(f"{part}{suffix}" for part in parts) for suffix in _FORMS)
    raise Source(folder, b"").error("COLMAP_FILE_MISSING", f"the folder does not contain {files}")


def _image_folder(model: Path) -> Path | None:
    """Return the folder of the photographs that belong to `model`, or None for a model outside a scene."""
    place = Path(os.path.abspath(model))  # noqa: PTH100 - resolve() would follow links
    if place.name.isdigit():
        place = place.parent
    return place.parent / "images" if place.name == "sparse" else None


def _camera(
    shot: Shot, shot_file: Source, lenses: dict[int, Lens], lens_file: Source, images: SpelledFiles | None
) -> Camera:
    """Return the camera of one image."""
    try:
        name = shot.name.decode("utf-8")
    except UnicodeDecodeError:
        text = f"the name of image id {shot.number} is not UTF-8"
        raise shot_file.error("CAMERA_INVALID", text, pointer=shot.pointer) from None
    what = f"image id {shot.number} ({shorten(name, 60)})"
    lens = lenses.get(shot.lens)
    if lens is None:
        text = f"{what} refers to camera id {shot.lens}, which is missing in {lens_file.path.name}"
        raise shot_file.error("COLMAP_INVALID", text, pointer=shot.pointer)
    with lens_file.locating(lens.pointer, f"camera id {lens.number}"):
        intrinsics, distortion = lens.intrinsics(), lens.distortion()
    if not MIN_QUATERNION < math.hypot(*shot.quaternion) < math.inf:
        numbers = " ".join(f"{value:g}" for value in shot.quaternion)
        text = f"{what} has the quaternion {numbers}; it must be finite and not zero"
        raise shot_file.error("COLMAP_INVALID", text, pointer=shot.pointer)
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(shot.quaternion)
    pose[:3, 3] = shot.translation
    with shot_file.locating(shot.pointer, what):
        check_name(name)  # reject an invalid name before searching its file
        image = None if images is None else images.find(name)
        return Camera(*intrinsics, pose, name, image, distortion=distortion)
