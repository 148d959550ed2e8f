"""Read a `Scene` from its folder: combine layout, rules, photographs and cameras."""

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from msb.asset.manifest import Manifest
from msb.base.files import check_folder, is_folder
from msb.base.paths import SpelledFiles, given_path
from msb.errors import Finding, MsbError, SceneError, finding, shorten
from msb.scenes.camera import Camera
from msb.scenes.colmap import count_images, list_models
from msb.scenes.colors import Color
from msb.scenes.datasets.catalog import CUSTOM, DATASETS, Layout, is_published, name_datasets
from msb.scenes.datasets.layout import find_layout, find_scenes, read_views
from msb.scenes.datasets.photographs import (
    MASKS,
    check_missing,
    choose_photographs,
    count_missing,
    find_masks,
    inspect_photographs,
    locate_photographs,
)
from msb.scenes.datasets.rulebook import OURS, RULES, evaluation_background, stated_background
from msb.scenes.datasets.rules import CONVENTIONS, ROUNDINGS, Convention, Rules, check_resolution
from msb.scenes.datasets.scene import MaskSource, Scene
from msb.scenes.datasets.splits import SplitViews, check_split, read_mask_paths, split_views
from msb.scenes.image_size import read_header

# If gs_fov moves the principal point by more than this distance in pixels, a warning is given.
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
    converts: bool = False,
) -> Scene:
    """Read a scene of a dataset. docs/datasets.md describes the layouts and the rules.

    Parameters
    ----------
    path : str or Path
        The scene's folder.
    dataset : str, optional
        An id of `DATASETS`, or any other name for another capture. Other captures are read by the rules of
        "custom". Default: the dataset is recognised by the names of the folder and its parent, and by the
        names and recorded sizes of the photographs.
    image_folder : str, optional
        The subfolder with photographs that replaces the folder in the rules.
    resolution : int, optional
        The resolution that replaces the rules' value, with the meaning of ``-r`` in the 3DGS family. The
        values 1, 2, 4 and 8 divide the size, and -1 keeps photographs up to 1600 pixels wide. Any other
        number is a width in pixels.
    camera_convention : {"gs_fov", "full_K"}, optional
        "gs_fov" uses the recorded angles of view and a principal point in the middle. "full_K" uses the
        recorded principal point. Use the convention of the checkpoint's training
        (`RULES[method].convention`). Default: the camera convention of the rules. The default of our rules is
        "full_K".
    background : (float, float, float), optional
        The background colour in [0, 1]. Default: white for masked datasets, otherwise the background of the
        rules. The default of our rules is black. Use `evaluation_background` for the benchmark's background
        of a method.
    rules : str
        A key of `RULES`: "ours", or a method, to read the scene like its official code.
    converts : bool
        Also accept photographs that need conversion: grey, WebP, AVIF and HEIC images.

    Returns
    -------
    Scene
        The scene. Only the headers of photographs are read. `msb.metrics.ground_truth` rotates, undistorts
        and masks photographs. In captures outside the benchmark, views without a photograph are removed with
        a warning, before the views are split. Scenes of the benchmark keep views without a photograph, but
        all their test photographs must exist.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        The code is one of the SCENE_, CAMERA_ and COLMAP_ codes.
    """
    root = given_path(path)
    layout = _require_layout(root)
    by = rules_of(rules)
    convention = camera_convention or by.convention
    if convention not in CONVENTIONS:
        text = f"the camera convention is {shorten(repr(convention), 40)}; it must be "
        raise SceneError("SCENE_ARGUMENT", text + " or ".join(CONVENTIONS))
    wish = None if resolution is None else check_resolution(resolution)
    warnings: list[Finding] = []
    key = dataset or _recognise(root, layout, warnings)
    color = evaluation_background(key) if rules == OURS else by.background_of(key)
    # Choose the folder of the photographs, read the recorded cameras, and split the cameras into training and
    # test views.
    chosen, how = choose_photographs(root, key, layout, root_name(root), by, image_folder, wish, warnings)
    every = _locate_views(root, layout, by, chosen.folder, is_requested=image_folder is not None)
    warnings += note_models(root, layout)
    split = partial(_split, root, layout, key, by)
    views, missing = split(every), count_missing([])
    if any(count_missing(views.views).values()):
        missing = count_missing(views.views)
        are_left_out = key not in DATASETS and rules == OURS
        check_missing(root, views.views, warnings, are_left_out=are_left_out)
        if are_left_out:
            views = split([view for view in every if count_missing([view]) == count_missing([])])
    warnings += views.notes
    check_split(root, views.views)
    # Find how photographs are rotated, undistorted and masked.
    stored = inspect_photographs(root, views.views, warnings, converts=converts)
    masks: tuple[MaskSource | None, Mapping[str, Path]] = (None, {})
    if chosen.compositing != "none":
        paths = {} if key in DATASETS else read_mask_paths(root, layout)
        masks = find_masks(root, key, views.views, paths, chosen.folder, warnings)
    # Resize the cameras to the evaluated size of the photographs.
    is_divided = wish is None and set(stored.sizes) == {chosen.divided_size}
    ratio = 1 if is_divided else chosen.resolution
    sizes = [ROUNDINGS[how](size, ratio) for size in stored.sizes]
    cameras = [view.resized(*size) for view, size in zip(stored.views, sizes, strict=True)]
    # Move the principal point to the middle, as the 3DGS family does. If the movement is visible, add a
    # warning.
    if convention == "gs_fov":
        warnings += _warn_shift(root, cameras)
        cameras = [camera.centered() for camera in cameras]
    return Scene(
        dataset=key,
        name=root_name(root),
        root=root,
        layout=layout,
        rules=rules,
        image_folder=chosen.folder,
        resolution=ratio,
        train=tuple(camera for camera in cameras if camera.split == "train"),
        test=tuple(camera for camera in cameras if camera.split == "test"),
        background=color if background is None else _check_color(background),
        camera_convention=convention,
        compositing="none" if masks[0] is None else chosen.compositing,
        mask_source=masks[0],
        masks=masks[1],
        readings=stored.readings,
        lens=views.views[0],
        split=views.source,
        missing=missing,
        resampling=by.resampling,
        quantized=by.quantized,
        gt_resized=sizes != stored.sizes,
        warnings=tuple(warnings),
    )


def _split(root: Path, layout: Layout, key: str, by: Rules, views: Sequence[Camera]) -> SplitViews:
    """Split the views of a scene.

    Outside the benchmark, only our rules use a recorded split.
    """
    is_fixed = key in DATASETS or by is not RULES[OURS]
    return split_views(root, layout, views, by_name=by.order == "name", is_benchmark=is_fixed)


def _locate_views(root: Path, layout: Layout, by: Rules, folder: str, *, is_requested: bool) -> list[Camera]:
    """Return the recorded cameras of a scene. Each camera has the path of its photograph."""
    views = read_views(root, layout, by, folder)
    return locate_photographs(root, layout, views, folder, is_requested=is_requested)


def scene_of_cameras(folder: Path, cameras: Sequence[Camera]) -> Scene:
    """Return a capture from a folder of photographs. All views are training views at their full size."""
    warnings: list[Finding] = []
    located = locate_photographs(folder, "colmap", cameras, ".", is_requested=False)
    views = [replace(view, split="train") for view in located]
    stored = inspect_photographs(folder, views, warnings, converts=True)
    sized = [view.resized(*size) for view, size in zip(stored.views, stored.sizes, strict=True)]
    return Scene(
        dataset=CUSTOM,
        name=root_name(folder),
        root=folder,
        layout="colmap",
        rules=OURS,
        image_folder=".",
        resolution=1,
        train=tuple(sized),
        test=(),
        background=evaluation_background(CUSTOM),
        camera_convention="full_K",
        compositing="none",
        readings=stored.readings,
        lens=views[0],
        warnings=tuple(warnings),
    )


def missing_photographs(
    path: str | os.PathLike[str],
    *,
    dataset: str | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    rules: str = OURS,
    **_others: Any,
) -> dict[str, int]:
    """Count missing training and test photographs. The scene may be invalid for `read_scene`.

    The parameters are the parameters of `read_scene`. Errors about cameras and folders are the same as in
    `read_scene`.
    """
    root = given_path(path)
    layout, by = _require_layout(root), rules_of(rules)
    key = dataset or _recognise(root, layout, [])
    try:
        chosen, _ = choose_photographs(root, key, layout, root_name(root), by, image_folder, resolution, [])
    except SceneError as error:
        if error.code != "SCENE_IMAGE_MISSING":
            raise
        views = [replace(view, image_path=None) for view in read_views(root, layout, by, "")]
    else:
        views = _locate_views(root, layout, by, chosen.folder, is_requested=image_folder is not None)
    return count_missing(_split(root, layout, key, by, views).views)


def note_models(root: Path, layout: Layout) -> list[Finding]:
    """Return a note if the folder `sparse` has several COLMAP models.

    Only the largest model in `sparse` is read.
    """
    models = list_models(root) if layout == "colmap" else []
    if len(models) < 2:
        return []
    first, second = (f"{count_images(model)} images" for model in models[:2])
    text = (
        f"sparse contains {len(models)} models; {models[0].name} with {first} is read, the next largest has "
        f"{second}"
    )
    return [finding("SCENE_LAYOUT", text, severity="info", file=str(root))]


def dataset_of(path: str | os.PathLike[str]) -> str:
    """Return the dataset of a scene, as `read_scene` recognises it."""
    root = given_path(path)
    return _recognise(root, _require_layout(root), [])


def _recognise(root: Path, layout: Layout, warnings: list[Finding]) -> str:
    """Return the dataset of a scene, or `CUSTOM`.

    The name of the scene or of its parent folder suggests a dataset. The names and recorded sizes of the
    photographs confirm the dataset. If the photographs do not confirm the dataset, a note is added to
    `warnings`.
    """
    place = _absolute_path(root)
    suggested: dict[str, bool] = {}
    for key, below in name_datasets(layout, place.name, place.parent.name):
        suggested.setdefault(key, below)
    if not suggested:
        return CUSTOM
    try:
        views = read_views(root, layout, RULES[OURS], "images")
    except MsbError:  # ignore this error, because `read_scene` raises it later
        return next(iter(suggested))
    names = [str(view.name) for view in views]
    sizes = {(view.width, view.height) for view in views}
    for key, below in suggested.items():
        if not is_published(key, place.name, names, sizes, below=below):
            continue
        if below or not DATASETS[key].masked or _is_masked(root, layout, views[0]):
            return key
    key = next(iter(suggested))
    text = (
        f"this folder has the name of a {DATASETS[key].title} scene, but other photographs; "
        f"its scene is read as another capture. Pass --dataset {key} to apply the rules of the benchmark"
    )
    warnings.append(finding("SCENE_UNKNOWN", text, severity="info", file=str(root)))
    return CUSTOM


def _is_masked(root: Path, layout: Layout, view: Camera) -> bool:
    """Return whether the scene has a folder of masks or photographs with an alpha channel."""
    if is_folder(root / MASKS):
        return True
    folder = "." if layout == "blender" else "images"
    with contextlib.suppress(MsbError):
        return read_header(SpelledFiles(root / folder).find(str(view.name))).has_alpha
    return False


def root_name(root: Path) -> str:
    """Return the name of a scene, which is the name of its folder."""
    return _absolute_path(root).name


def _absolute_path(root: Path) -> Path:
    """Return the absolute path without following links."""
    return Path(os.path.abspath(root))  # noqa: PTH100 - resolve() would follow links


def _require_layout(root: Path) -> Layout:
    """Return the layout of a scene's folder. If the folder is not a scene, raise an error."""
    check_folder(root)
    layout = find_layout(root)
    if layout is None:
        scenes = find_scenes(root)  # raises an error if the folder contains no scenes
        names = ", ".join(scene.relative_to(root).as_posix() for scene in scenes[:4])
        text = f"it is not a scene but contains {len(scenes)}: {shorten(names)}; pass one of them"
        raise SceneError("SCENE_LAYOUT", text, file=root)
    return layout


def rules_of(name: str) -> Rules:
    """Return the dataset rules with this name."""
    if name not in RULES:
        text = f"rules {shorten(repr(name), 40)} do not exist; choose one of {', '.join(RULES)}"
        raise SceneError("SCENE_ARGUMENT", text)
    return RULES[name]


def _check_color(values: Sequence[float]) -> Color:
    """Return the background as a colour. Each channel must be from 0 to 1."""
    if len(values) != 3 or not all(0 <= value <= 1 for value in values):
        text = f"the background is {shorten(repr(values), 60)}; it must be red, green and blue from 0 to 1"
        raise SceneError("SCENE_ARGUMENT", text)
    red, green, blue = map(float, values)
    return red, green, blue


def _warn_shift(root: Path, cameras: Sequence[Camera]) -> list[Finding]:
    """Return a warning if the principal point is visibly away from the middle of the image."""
    far = max(max(abs(c.cx - c.width / 2), abs(c.cy - c.height / 2)) for c in cameras)
    if far <= MAX_SHIFT:
        return []
    text = (
        f"gs_fov moves the recorded principal point by up to {far:.1f} pixels to the middle of the image. If "
        f"the model was trained with the recorded point, pass --camera-convention full_K"
    )
    return [finding("SCENE_PRINCIPAL_POINT", text, severity="warning", file=str(root), value=far)]


@dataclass(frozen=True)
class SceneAt:
    """A scene for the evaluation of a method.

    The class holds the arguments of `read_scene` and the scene's name in the results.
    """

    dataset: str
    name: str
    path: Path
    image_folder: str | None
    resolution: int | None
    background: Color
    camera_convention: Convention

    @lru_cache(maxsize=8)  # noqa: B019 - at most eight scenes stay in memory
    def read(self) -> Scene:
        """Return the scene. Recently read scenes are cached."""
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
    """Describe the evaluation of a method on a scene without reading the scene's folder.

    `official_background` is the background in the method's official evaluation, if the model records one. The
    last four arguments override the rules, as in `read_scene`. By default, our rules define the size, the
    method's training defines the camera convention, and `evaluation_background` returns the background.
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
    dataset: str | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    camera_convention: Convention | None = None,
) -> Scene:
    """Return a scene prepared to evaluate the method of a model.

    The errors are the errors of `read_scene`.
    """
    place = given_path(path)
    notes: list[Finding] = []
    at = scene_at(
        place,
        dataset or _recognise(place, _require_layout(place), notes),
        manifest.method,
        official_background=stated_background(manifest),
        image_folder=image_folder,
        resolution=resolution,
        camera_convention=camera_convention,
    )
    scene = at.read()
    return replace(scene, warnings=(*notes, *scene.warnings)) if notes else scene
