"""Read a `Scene` from its folder: combine layout, rules, photographs and cameras."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from msb.asset.manifest import Manifest
from msb.base.files import check_folder
from msb.base.paths import SpelledFiles, given_path
from msb.errors import Finding, SceneError, finding, shorten
from msb.scenes.camera import Camera
from msb.scenes.colors import Color
from msb.scenes.datasets.catalog import Layout, guess_dataset
from msb.scenes.datasets.layout import find_layout, find_scenes, read_views
from msb.scenes.datasets.photographs import (
    choose_photographs,
    count_missing,
    find_masks,
    photograph_sizes,
)
from msb.scenes.datasets.rulebook import OURS, RULES, evaluation_background, stated_background
from msb.scenes.datasets.rules import CONVENTIONS, ROUNDINGS, Convention, Rules, check_resolution
from msb.scenes.datasets.scene import Scene

# Distance in pixels that gs_fov may move the principal point without a warning.
MAX_SHIFT = 0.5


def read_scene(
    path: str | os.PathLike[str],
    *,
    dataset: str | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    camera_convention: Convention | None = None,
    background: Sequence[float] | None = None,
    rules: str = OURS,
) -> Scene:
    """Read a scene of a dataset. docs/datasets.md describes the layouts and the rules.

    Parameters
    ----------
    path : str or Path
        The scene's folder.
    dataset : str, optional
        An id of `DATASETS`, or any other name for another capture, which is read by the rules of "custom".
        Default: derived from the names of the folder and its parent.
    image_folder : str, optional
        The folder below the scene to use instead of the rules' folder.
    resolution : int, optional
        The resolution, instead of the rules' value, with the meaning of ``-r`` in the 3DGS family: 1, 2, 4 or
        8 divide the size, -1 keeps photographs up to 1600 pixels wide, any other number is a width in pixels.
    camera_convention : {"gs_fov", "full_K"}, optional
        "gs_fov" uses the recorded angles of view and a principal point in the middle; "full_K" uses the
        recorded principal point. It must be the convention that the checkpoint was trained with
        (`RULES[method].convention`). Default: the convention of the rules, which is "gs_fov" for ours.
    background : (float, float, float), optional
        The background colour in [0, 1]. Default: white for masked datasets, else the rules' background, black
        for ours. `evaluation_background` returns the benchmark's background for a method.
    rules : str
        A key of `RULES`: "ours", or a method, to read the scene like its official code.

    Returns
    -------
    Scene
        The scene. Only the headers of photographs are read. A missing training photograph causes a warning;
        test photographs must exist.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        One of the SCENE_, CAMERA_ and COLMAP_ codes.
    """
    root = given_path(path)
    layout = _require_layout(root)
    by = rules_of(rules)
    place = _absolute_path(root)
    key = dataset or guess_dataset(layout, place.name, place.parent.name)
    convention = camera_convention or by.convention
    if convention not in CONVENTIONS:
        text = f"the camera convention is {shorten(repr(convention), 40)}; it must be "
        raise SceneError("SCENE_ARGUMENT", text + " or ".join(CONVENTIONS))
    wish = None if resolution is None else check_resolution(resolution)
    color = evaluation_background(key) if rules == OURS else by.background_of(key)
    warnings: list[Finding] = []
    # Choose the folder and the size of the photographs.
    chosen, how = choose_photographs(root, key, layout, place.name, by, image_folder, wish, warnings)
    files = SpelledFiles(root / chosen.folder)
    # Read the recorded cameras, and find the photograph of each.
    views = _find_photographs(root, layout, by, chosen.folder, files)
    native = photograph_sizes(root, views, warnings)
    masks = (None, {}) if chosen.compositing == "none" else find_masks(root, key, views)
    # Resize the cameras to the evaluated size of their photographs.
    rounding = ROUNDINGS[how]
    cameras = [
        view.resized(*rounding(size, chosen.resolution)) for view, size in zip(views, native, strict=True)
    ]
    resized = any((c.width, c.height) != size for c, size in zip(cameras, native, strict=True))
    # Like the 3DGS family, move the principal point to the middle; warn if the move is visible.
    if convention == "gs_fov":
        warnings += _warn_shift(root, cameras)
        cameras = [camera.centered() for camera in cameras]
    return Scene(
        dataset=key,
        name=place.name,
        root=root,
        layout=layout,
        rules=rules,
        image_folder=chosen.folder,
        resolution=chosen.resolution,
        train=tuple(camera for camera in cameras if camera.split == "train"),
        test=tuple(camera for camera in cameras if camera.split == "test"),
        background=color if background is None else _check_color(background),
        camera_convention=convention,
        compositing="none" if masks[0] is None else chosen.compositing,
        mask_source=masks[0],
        masks=masks[1],
        resampling=by.resampling,
        quantized=by.quantized,
        gt_resized=resized,
        warnings=tuple(warnings),
    )


def missing_photographs(
    path: str | os.PathLike[str],
    *,
    dataset: str | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    rules: str = OURS,
) -> dict[str, int]:
    """Return how many training and test photographs are missing, also for a scene that is rejected.

    Parameters are those of `read_scene`. Errors of `read_scene` about cameras and folders are raised, too.
    """
    root = given_path(path)
    layout, by = _require_layout(root), rules_of(rules)
    place = _absolute_path(root)
    key = dataset or guess_dataset(layout, place.name, place.parent.name)
    try:
        chosen, _ = choose_photographs(root, key, layout, place.name, by, image_folder, resolution, [])
    except SceneError as error:
        if error.code != "SCENE_IMAGE_MISSING":
            raise
        return count_missing([replace(view, image_path=None) for view in read_views(root, layout, by, "")])
    files = SpelledFiles(root / chosen.folder)
    return count_missing(_find_photographs(root, layout, by, chosen.folder, files))


def _find_photographs(
    root: Path, layout: Layout, by: Rules, folder: str, files: SpelledFiles
) -> list[Camera]:
    """Return the recorded cameras of a scene, each with the path of its photograph."""
    views = read_views(root, layout, by, folder)
    return [replace(view, image_path=files.find(str(view.name))) for view in views]


def dataset_of(path: str | os.PathLike[str]) -> str:
    """Return the dataset of a scene, derived from the names of its folder and its parent."""
    root = given_path(path)
    layout, place = _require_layout(root), _absolute_path(root)
    return guess_dataset(layout, place.name, place.parent.name)


def _absolute_path(root: Path) -> Path:
    """Return the absolute path; links are not followed, so the names stay as given."""
    return Path(os.path.abspath(root))  # noqa: PTH100 - resolve() would follow links


def _require_layout(root: Path) -> Layout:
    """Return the layout of a scene's folder; raise an error if it is not a scene."""
    check_folder(root)
    layout = find_layout(root)
    if layout is None:
        scenes = find_scenes(root)  # raises an error if the folder contains no scenes either
        names = ", ".join(scene.relative_to(root).as_posix() for scene in scenes[:4])
        text = f"it is not a scene but contains {len(scenes)}: {shorten(names)}; pass one of them"
        raise SceneError("SCENE_LAYOUT", text, file=root)
    return layout


def rules_of(name: str) -> Rules:
    """Return the rules of this name."""
    if name not in RULES:
        text = f"rules {shorten(repr(name), 40)} do not exist; choose one of {', '.join(RULES)}"
        raise SceneError("SCENE_ARGUMENT", text)
    return RULES[name]


def _check_color(values: Sequence[float]) -> Color:
    """Return the background as a colour; each channel must be from 0 to 1."""
    if len(values) != 3 or not all(0 <= value <= 1 for value in values):
        text = f"the background is {shorten(repr(values), 60)}; it must be red, green and blue from 0 to 1"
        raise SceneError("SCENE_ARGUMENT", text)
    red, green, blue = map(float, values)
    return red, green, blue


def _warn_shift(root: Path, cameras: Sequence[Camera]) -> list[Finding]:
    """Return a warning if the principal point is visibly off the middle of the image."""
    far = max(max(abs(c.cx - c.width / 2), abs(c.cy - c.height / 2)) for c in cameras)
    if far <= MAX_SHIFT:
        return []
    text = (
        f"gs_fov moves the recorded principal point by up to {far:.1f} pixels to the middle of the image; "
        "checkpoints trained with the recorded point need camera_convention full_K"
    )
    return [finding("SCENE_PRINCIPAL_POINT", text, severity="warning", file=str(root), value=far)]


@dataclass(frozen=True)
class SceneAt:
    """A scene for the evaluation of a method: arguments of `read_scene`, and its name in the results."""

    dataset: str
    name: str
    path: Path
    image_folder: str | None
    resolution: int | None
    background: Color
    camera_convention: Convention

    @lru_cache(maxsize=8)  # noqa: B019 - at most eight scenes stay in memory
    def read(self) -> Scene:
        """Return the scene; recently read scenes are cached."""
        return read_scene(**{key: value for key, value in vars(self).items() if key != "name"})


def scene_at(
    path: Path,
    dataset: str,
    method: str,
    *,
    official_background: Color | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    background: Color | None = None,
    camera_convention: Convention | None = None,
) -> SceneAt:
    """Return how a method is evaluated on a scene, without reading its folder.

    `official_background` is the background of the method's official evaluation, if the model records it. The
    last four arguments override the rules, as in `read_scene`. By default the size follows our rules, the
    camera convention is the one of the method's training, and the background is `evaluation_background`.
    """
    return SceneAt(
        dataset=dataset,
        name=path.name,
        path=path,
        image_folder=image_folder,
        resolution=resolution,
        background=background or evaluation_background(dataset, method, official_background),
        camera_convention=camera_convention or RULES.get(method, RULES[OURS]).convention,
    )


def scene_of(
    manifest: Manifest,
    path: str | os.PathLike[str],
    *,
    image_folder: str | None = None,
    resolution: int | None = None,
) -> Scene:
    """Return the scene in a folder as it is used to evaluate a model's method; raises like `read_scene`."""
    place = given_path(path)
    at = scene_at(
        place,
        dataset_of(place),
        manifest.method,
        official_background=stated_background(manifest),
        image_folder=image_folder,
        resolution=resolution,
    )
    return at.read()
