"""Cameras that were recorded for larger images than the photographs that are there."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msb.base.files import is_file, is_folder
from msb.base.paths import SpelledFiles, given_path
from msb.errors import MsbError, shorten
from msb.scenes.colmap import find_model
from msb.scenes.datasets.layout import folders
from msb.scenes.image_size import image_size

if TYPE_CHECKING:
    from msb.scenes.camera import Camera
    from msb.scenes.datasets.scene import Scene
    from msb.scenes.datasets.sizes import Size

_FAR = 1.5
"""Cameras are far larger than photographs if they are this many times as wide."""


def scaled_note(scenes: Iterable[Scene]) -> str | None:
    """Return a sentence on scenes whose cameras were recorded far larger than their photographs are.

    Parameters
    ----------
    scenes : iterable of Scene
        One of them is described, the others are counted.
    """
    found = {scene.root: text for scene in scenes if (text := _scaled(scene)) is not None}
    if not found:
        return None
    more = len(found) - 1
    alike = f"; so it is in {more} more scene{'s' if more > 1 else ''}" if more else ""
    return f"{next(iter(found.values()))}{alike}"


def _scaled(scene: Scene) -> str | None:
    view = scene.test[0]
    recorded, used = view.source_size or (view.width, view.height), (view.width, view.height)
    stored = None if view.image_path is None else _stored(view.image_path)
    if stored is None or recorded[0] < _FAR * stored[0]:
        return None
    place = "" if scene.image_folder == "." else f" in {shorten(scene.image_folder, 40)}"
    return (
        f"the cameras of {shorten(scene.name, 40)} were recorded at {_text(recorded)} pixels, the photographs"
        f"{place} have {_text(stored)}: the cameras are scaled, {_text(used)} is drawn and compared"
    )


def recorded_note(path: str | os.PathLike[str], cameras: Sequence[Camera]) -> str | None:
    """Return a sentence on cameras of a COLMAP model that are drawn far larger than photographs beside it.

    Parameters
    ----------
    path : str or Path
        Where `read_cameras` found the cameras.
    cameras : sequence of Camera
        At least one, as recorded.
    """
    view = cameras[0]
    found = photographs_beside(path, cameras)
    if found is None or view.width < _FAR * found[1][0]:
        return None
    folder, size = found
    return (
        f"the cameras are drawn as recorded, at {view.width} x {view.height} pixels; the photographs in "
        f"{shorten(folder.name, 40)} have {_text(size)}: --scale {size[0] / view.width:.4g} draws "
        "at their size"
    )


def photographs_beside(path: str | os.PathLike[str], cameras: Sequence[Camera]) -> tuple[Path, Size] | None:
    """Return the folder of the largest photographs of a COLMAP scene, and their size; arguments as above."""
    place = given_path(path)
    model = find_model(place) if is_folder(place) else None
    if model is None:
        return None
    root = next((above.parent for above in (model, model.parent) if above.name == "sparse"), model)
    sizes: dict[Size, Path] = {}
    for folder in folders(root):
        with contextlib.suppress(MsbError):
            file = SpelledFiles(folder).find(str(cameras[0].name))
            size = _stored(file) if folder.name.startswith("images") else None
            if size is not None:
                sizes[size] = folder
    return (sizes[max(sizes)], max(sizes)) if sizes else None


def _stored(file: Path) -> Size | None:
    """Return the size of an image, None if it is not there or cannot be read."""
    with contextlib.suppress(MsbError):
        return image_size(file) if is_file(file) else None
    return None


def _text(size: Size) -> str:
    return f"{size[0]} x {size[1]}"
