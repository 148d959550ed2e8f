"""The layout of a scene's folder, the search for scenes below a folder, and a scene's recorded cameras."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from msb.base.files import check_folder, is_file, is_folder
from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.colmap import find_model
from msb.scenes.datasets.catalog import Layout
from msb.scenes.datasets.neus import MATRICES, read_neus
from msb.scenes.datasets.rules import Rules
from msb.scenes.image_size import IMAGE_SUFFIXES
from msb.scenes.read import read_cameras
from msb.scenes.sets import check_set
from msb.scenes.source import Source

TRAIN, TEST, SINGLE = "transforms_train.json", "transforms_test.json", "transforms.json"
VALIDATION = "transforms_val.json"


def find_layout(folder: Path) -> Layout | None:
    """Return the layout of `folder`. If the folder is not a scene, return None.

    A folder `sparse` takes precedence over transforms_train.json, as in the 3DGS family (scene/__init__.py).
    The file cameras.npz is used only if `sparse` and transforms_train.json are missing.
    """
    if is_folder(folder / "sparse"):
        return "colmap"
    if is_file(folder / TRAIN) or is_file(folder / TEST):
        return "blender"
    if is_file(folder / SINGLE):
        return "transforms"
    if is_file(folder / MATRICES):
        return "neus"
    return None


def find_scenes(path: Path) -> list[Path]:
    """Return the scenes at `path`.

    The result contains the folder itself, or scenes at most two levels below the folder.
    """
    check_folder(path)
    if find_layout(path) is not None:
        return [path]
    scenes = [scene for child in folders(path) for scene in _scenes_below(child)]
    if not scenes:
        text = (
            f"no scene was found: sparse/0, {TRAIN} and {MATRICES} are missing here and in subfolders; "
            "docs/datasets.md describes the layouts"
        )
        raise SceneError("SCENE_LAYOUT", text, file=path)
    return scenes


def _scenes_below(folder: Path) -> list[Path]:
    """Return `folder` if it is a scene, otherwise the scenes in `folder`."""
    if find_layout(folder) is not None:
        return [folder]
    return [child for child in folders(folder) if find_layout(child) is not None]


def folders(path: Path) -> Iterator[Path]:
    """Yield the visible subfolders of `path`, sorted by name."""
    yield from (child for child in _children(path) if not child.name.startswith(".") and is_folder(child))


def images_in(folder: Path) -> list[Path]:
    """Return the image files in `folder`, sorted by name. If the folder does not exist, the list is empty."""
    images = (child for child in _children(folder) if child.suffix.lower() in IMAGE_SUFFIXES)
    return [image for image in images if is_file(image)]


def _children(folder: Path) -> list[Path]:
    """Return the sorted content of a folder. If the folder cannot be read, the list is empty."""
    with contextlib.suppress(OSError):
        return sorted(folder.iterdir())
    return []


def read_views(root: Path, layout: Layout, rules: Rules, image_folder: str) -> list[Camera]:
    """Return the recorded cameras of the scene at `root`.

    Only cameras of the layout "blender" have a split into training and test views.
    """
    if layout == "blender":
        return _read_blender(root)
    views = _read_unsplit(root, layout, image_folder)
    return [_with_lens(view, views[0]) for view in views] if rules.first_lens else views


def _read_blender(root: Path) -> list[Camera]:
    """Return the cameras of the JSON files for training and tests.

    If the file for tests is missing, the validation views become test views.
    """
    if is_file(root / TRAIN) and is_file(root / TEST):
        return read_cameras(root)
    if is_file(root / TRAIN) and is_file(root / VALIDATION):
        views = [*read_cameras(root / TRAIN), *read_cameras(root / VALIDATION)]
        check_set(views, Source(root / VALIDATION, b""))
        return [replace(view, split="test" if view.split == "val" else view.split) for view in views]
    name, other = (TEST, TRAIN) if is_file(root / TRAIN) else (TRAIN, TEST)
    text = f"{name} is missing; a scene with {other} needs both files"
    raise SceneError("SCENE_LAYOUT", text, file=root, pointer=name)


def _read_unsplit(root: Path, layout: Layout, image_folder: str) -> list[Camera]:
    """Return the cameras of a scene whose layout has no split."""
    if layout == "transforms":
        return read_cameras(root / SINGLE)
    if layout == "neus":
        return read_neus(root / MATRICES, images_in(root / image_folder))
    model = find_model(root)
    if model is None:
        text = "sparse/0 contains no COLMAP model: it needs cameras and images, both .bin or both .txt"
        raise SceneError("SCENE_LAYOUT", text, file=root)
    return read_cameras(model)


def _with_lens(view: Camera, first: Camera) -> Camera:
    """Return `view` with the intrinsics of `first`, scaled to the image size of `view`."""
    x, y = view.width / first.width, view.height / first.height
    return replace(view, fx=first.fx * x, fy=first.fy * y, cx=first.cx * x, cy=first.cy * y)
