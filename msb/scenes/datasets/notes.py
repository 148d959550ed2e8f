"""What should be known of a scene: its cameras' size beside its photographs', and how a model was trained."""

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from msb.base.files import is_file, is_folder
from msb.base.paths import SpelledFiles, given_path
from msb.errors import Finding, MsbError, finding, shorten
from msb.scenes.camera import Camera
from msb.scenes.colmap import find_model
from msb.scenes.colors import Color
from msb.scenes.datasets.describe import color_name
from msb.scenes.datasets.layout import folders
from msb.scenes.datasets.rules import AS_IS, Size, half_even
from msb.scenes.datasets.scene import Scene
from msb.scenes.image_size import image_size

# Cameras are far larger than photographs if they are this many times as wide.
_FAR = 1.5


def scaled_note(scenes: Iterable[Scene]) -> str | None:
    """Return a sentence on scenes whose cameras were recorded far larger than their photographs are.

    The first is described, the others are counted.
    """
    sentences = {scene.root: text for scene in scenes if (text := _scaled(scene)) is not None}
    if not sentences:
        return None
    more = len(sentences) - 1
    alike = f"; so it is in {more} more scene{'s' if more > 1 else ''}" if more else ""
    return f"{next(iter(sentences.values()))}{alike}"


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

    `path` is where `read_cameras` found the cameras, which are as recorded.
    """
    view = cameras[0]
    beside = photographs_beside(path, cameras)
    if beside is None or view.width < _FAR * beside[1][0]:
        return None
    folder, size = beside
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


def trained_otherwise(training: Mapping[str, Any], own: Color | None, scene: Scene) -> Iterator[Finding]:
    """Yield a warning for each way in which the `training` of a manifest differs from how `scene` counts.

    `own` is the background that the model was trained over, where the asset states it.
    """
    if training.get("eval") is False:
        yield saw_test_views()
    if own is not None and own != scene.background:
        yield over_another(own, scene.background)
    there = scene.test[0].width, scene.test[0].height
    size = _size(training, scene)
    if size is not None and max(abs(a - b) for a, b in zip(size, there, strict=True)) > 1:
        before, now = (f"{width} x {height}" for width, height in (size, there))
        yield _otherwise(
            f"it was trained on photographs of {before} pixels and is evaluated at {now}: its numbers are "
            "not those of a model that was trained at that size"
        )


def saw_test_views() -> Finding:
    """Return the warning about a model that was trained on all views."""
    return _otherwise("it was trained on the test views (eval=False): its numbers on them are not comparable")


def over_another(own: Color, drawn: Color) -> Finding:
    """Return the warning about a model that is drawn over another colour than the one it was trained over."""
    return _otherwise(
        f"it was trained over {color_name(own)} and is drawn over {color_name(drawn)}: where the background "
        "shows, it differs from photographs for that alone"
    )


def _otherwise(text: str) -> Finding:
    return finding("CHECKPOINT_CONFIG", text, severity="warning")


def _size(training: Mapping[str, Any], scene: Scene) -> Size | None:
    """Return the size of the photographs of the training, None where it cannot be told."""
    if "width" in training and "height" in training:
        return training["width"], training["height"]
    view, folder = scene.test[0], training.get("images")
    if folder in (None, "..") or scene.layout != "colmap":  # elsewhere the folder is not asked
        return None
    stored: Size | None = None
    with contextlib.suppress(MsbError):
        stored = image_size(SpelledFiles(scene.root / folder).find(str(view.name)))
    if stored is None and (divided := re.fullmatch(r"images_([1-9]\d?)", folder)):
        width, height = view.source_size or (view.width, view.height)
        stored = round(width / int(divided[1])), round(height / int(divided[1]))
    resolution = training.get("resolution")
    if stored is None or resolution is None:
        return stored
    return half_even(stored, resolution) if resolution == AS_IS or resolution > 0 else None
