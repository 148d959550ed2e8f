"""Notes about a scene: unexpected image sizes, and differences between training and evaluation."""

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

# Minimum ratio of the recorded width to the photograph's width for which a note is made.
_FAR = 1.5


def note_scaled_cameras(scenes: Iterable[Scene]) -> str | None:
    """Return a sentence about scenes whose recorded image sizes far exceed their photographs. If there are no
    such scenes, return None.

    The sentence describes the first of these scenes and counts the other scenes.
    """
    sentences = {scene.root: text for scene in scenes if (text := _describe_scaling(scene)) is not None}
    if not sentences:
        return None
    more = len(sentences) - 1
    alike = f" (the same applies to {more} more scene{'s' if more > 1 else ''})" if more else ""
    return f"{next(iter(sentences.values()))}{alike}"


def _describe_scaling(scene: Scene) -> str | None:
    """Return the sentence about recorded image sizes for a single scene.

    If the two sizes are similar, return None.
    """
    view = scene.test[0]
    recorded, used = view.source_size or (view.width, view.height), (view.width, view.height)
    stored = None if view.image_path is None else _read_size(view.image_path)
    if stored is None or recorded[0] < _FAR * stored[0]:
        return None
    place = "" if scene.image_folder == "." else f" in {shorten(scene.image_folder, 40)}"
    return (
        f"the cameras of {shorten(scene.name, 40)} were recorded at {_format_size(recorded)} pixels, but the "
        f"photographs{place} have {_format_size(stored)}; cameras are scaled, and the compared images have "
        f"{_format_size(used)}"
    )


def note_recorded_size(path: str | os.PathLike[str], cameras: Sequence[Camera]) -> str | None:
    """Return a sentence about a COLMAP model whose recorded image sizes far exceed the photographs beside it.
    If the recorded sizes agree with the photographs, return None.

    `path` is the argument of `read_cameras`, and `cameras` is the result.
    """
    view = cameras[0]
    beside = find_photographs(path, cameras)
    if beside is None or view.width < _FAR * beside[1][0]:
        return None
    folder, size = beside
    return (
        f"images are rendered at the recorded size of the cameras, {view.width} x {view.height} pixels; the "
        f"photographs in {shorten(folder.name, 40)} have {_format_size(size)}: pass --scale "
        f"{size[0] / view.width:.4g} to render at their size"
    )


def find_photographs(path: str | os.PathLike[str], cameras: Sequence[Camera]) -> tuple[Path, Size] | None:
    """Return the folder with the largest photographs of a COLMAP scene, and their size.

    The result is None if the scene has no photographs.

    The arguments are the arguments of `note_recorded_size`.
    """
    place = given_path(path)
    model = find_model(place) if is_folder(place) else None
    if model is None:
        return None
    root = next((above.parent for above in (model, model.parent) if above.name == "sparse"), model)
    # In all folders images*, read the size of the first camera's photograph.
    sizes: dict[Size, Path] = {}
    for folder in folders(root):
        with contextlib.suppress(MsbError):
            file = SpelledFiles(folder).find(str(cameras[0].name))
            size = _read_size(file) if folder.name.startswith("images") else None
            if size is not None:
                sizes[size] = folder
    return (sizes[max(sizes)], max(sizes)) if sizes else None


def _read_size(file: Path) -> Size | None:
    """Return the size of an image. If the image is missing or cannot be read, return None."""
    with contextlib.suppress(MsbError):
        return image_size(file) if is_file(file) else None
    return None


def _format_size(size: Size) -> str:
    """Return a size as text."""
    return f"{size[0]} x {size[1]}"


def compare_training(
    training: Mapping[str, Any], background: Color | None, scene: Scene
) -> Iterator[Finding]:
    """Yield a warning for each difference between the training of a model and the evaluation on `scene`.

    `training` is the manifest's section "training". `background` is the colour behind the training images, if
    the asset records this colour.
    """
    if training.get("eval") is False:
        yield warn_test_views()
    if background is not None and background != scene.background:
        yield warn_background(background, scene.background)
    evaluated = scene.test[0].width, scene.test[0].height
    size = _training_size(training, scene)
    if size is not None and max(abs(a - b) for a, b in zip(size, evaluated, strict=True)) > 1:
        yield _warn_training(
            f"it was trained on photographs of {_format_size(size)} pixels and is evaluated at "
            f"{_format_size(evaluated)}; results may differ from a model trained at that size"
        )


def warn_test_views() -> Finding:
    """Return the warning about a model that was trained on all views."""
    return _warn_training(
        "the model was trained on the test views (eval=False); results on test views are not comparable"
    )


def warn_unknown_split() -> Finding:
    """Return the warning about a model that does not record which views were held out."""
    return _warn_training(
        "its training does not record which views were held out; if test views were used for training, "
        "results are too good"
    )


def warn_background(background: Color, drawn: Color) -> Finding:
    """Return the warning for a model whose training had another background."""
    return _warn_training(
        f"the model was trained over {color_name(background)} and is rendered over {color_name(drawn)}; "
        "visible background differs from the photographs"
    )


def _warn_training(text: str) -> Finding:
    """Return a warning about the training of the model."""
    return finding("CHECKPOINT_CONFIG", text, severity="warning")


def _training_size(training: Mapping[str, Any], scene: Scene) -> Size | None:
    """Return the size of the photographs in the training; None if it is unknown."""
    if "width" in training and "height" in training:
        return training["width"], training["height"]
    view, folder = scene.test[0], training.get("images")
    if folder in (None, "..") or scene.layout != "colmap":  # only the layout "colmap" has image folders
        return None
    # Read the size of the stored photographs. If the folder images_N is missing, use the published size of
    # its images.
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
