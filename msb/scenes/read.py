"""Read cameras from a path. The files at the path determine the reader."""

import os
from pathlib import Path

from msb.base.files import is_file, is_folder
from msb.base.paths import given_path
from msb.scenes import cameras_json, transforms, views_json
from msb.scenes.camera import Camera
from msb.scenes.colmap import find_model, read_model
from msb.scenes.json_node import read_json
from msb.scenes.sets import check_set
from msb.scenes.source import Source

# Groups of file names that contain cameras. In a folder, only the first existing group is read.
_IN_FOLDERS = (
    ("transforms_train.json", "transforms_test.json"),
    ("transforms.json",),
    ("cameras.json",),
    ("views.json",),
)


def read_cameras(path: str | os.PathLike[str]) -> list[Camera]:
    """Read the cameras of a dataset, a trained model or a views.json.

    Parameters
    ----------
    path : str or Path
        A JSON file, recognised by its content: transforms_*.json (NeRF-Synthetic, instant-ngp, nerfstudio),
        A file cameras.json (3DGS family) or views.json. In a folder, the first existing source is read: a
        COLMAP model, transforms_train.json with transforms_test.json, transforms.json, cameras.json or
        views.json. A COLMAP model may be in the folder itself, in `sparse/0` or in `sparse`. The suffix .bin
        is preferred to .txt.

    Returns
    -------
    cameras : list of Camera
        At least one camera, in the file's order, with unique names. Intrinsics and principal point are
        returned as recorded. Use `Camera.centered` for the camera that the 3DGS family renders. `split` is
        set only if the source contains a split. Otherwise use `split_every_8th`.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        The code is one of the CAMERA_ and COLMAP_ codes.

    Notes
    -----
    Files are untrusted: sizes are checked before memory is allocated, time and memory are linear in the
    files' sizes, and paths that point outside the folder are not opened.
    """
    place = given_path(path)
    if is_folder(place):
        return _read_folder(place)
    source = Source.open(place)
    cameras = _read_json(source)
    check_set(cameras, source)
    return cameras


def _read_folder(folder: Path) -> list[Camera]:
    """Return the cameras of the first camera file found in a folder."""
    model = find_model(folder)
    if model is not None:
        cameras = read_model(model)
        check_set(cameras, Source(model, b""))
        return cameras
    for names in _IN_FOLDERS:
        files = [folder / name for name in names if is_file(folder / name)]
        if files:
            cameras = [camera for file in files for camera in _read_json(Source.open(file))]
            check_set(cameras, Source(files[0], b""))
            return cameras
    looked = "sparse/0, sparse, " + ", ".join(name for names in _IN_FOLDERS for name in names)
    raise Source(folder, b"").error("CAMERA_SOURCE", f"the folder contains no cameras; searched {looked}")


def _read_json(source: Source) -> list[Camera]:
    """Return the cameras of a JSON file. The content of the file determines its format."""
    if source.path.suffix.lower() in (".bin", ".txt"):
        raise source.error("CAMERA_SOURCE", "it is a file of a COLMAP model; pass the model's folder")
    if source.path.suffix.lower() != ".json":
        text = (
            f"files with the suffix '{source.path.suffix}' contain no cameras; pass a .json file or a folder"
        )
        raise source.error("CAMERA_SOURCE", text)
    root = read_json(source)
    if isinstance(root.value, list):
        return cameras_json.read(root)
    if isinstance(root.value, dict) and "schema" in root.value:
        return views_json.read(root).cameras
    if isinstance(root.value, dict) and "frames" in root.value:
        return transforms.read(root)
    text = (
        'it is not a camera file: expected an object with "frames" (transforms.json) or "schema" '
        "(views.json), or an array (cameras.json)"
    )
    raise root.source.error("CAMERA_SOURCE", text)
