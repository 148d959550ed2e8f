"""From a scene's folder to a `Scene`: layout, rules, photographs and cameras brought together."""

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
from msb.scenes.datasets.photographs import choose_photographs, find_masks, photograph_sizes
from msb.scenes.datasets.rulebook import OURS, RULES, evaluation_background, stated_background
from msb.scenes.datasets.rules import CONVENTIONS, ROUNDINGS, Convention, Rules, check_resolution
from msb.scenes.datasets.scene import Scene

# Pixels by which gs_fov may move the principal point without a warning.
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
    """Read one scene of a dataset. docs/datasets.md shows the layouts and the rules.

    Parameters
    ----------
    path : str or Path
        The scene's folder.
    dataset : str, optional
        An id of `DATASETS`, or any other name for a capture of one's own, which has the rules of "custom".
        Default: told by the names of the folder and the one above it.
    image_folder : str, optional
        The folder below the scene that is taken instead of the one that the rules name.
    resolution : int, optional
        The resolution, with the meaning of ``-r`` in the 3DGS family, instead of the rules' own: 1, 2, 4 or 8
        divide the size, -1 leaves photographs up to 1600 pixels wide alone, any other number is a width in
        pixels.
    camera_convention : {"gs_fov", "full_K"}, optional
        "gs_fov" takes the recorded angles of view and puts the principal point into the middle; "full_K"
        takes the recorded principal point. It must be what the checkpoint was trained with
        (`RULES[method].convention`). Default: that of the rules, which is "gs_fov" for ours.
    background : (float, float, float), optional
        The background colour in [0, 1]. Default: white for the masked datasets, else that of the rules, black
        for ours. `evaluation_background` gives what the benchmark takes for a method.
    rules : str
        A key of `RULES`: "ours", or a method, to read the scene as its official code does.

    Returns
    -------
    Scene
        The scene. Of photographs only the headers are read. A missing training photograph gives a warning;
        test photographs must be there.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    SceneError
        One of the SCENE_, CAMERA_ and COLMAP_ codes.
    """
    root = given_path(path)
    layout = _layout(root)
    by = rules_of(rules)
    place = _place(root)
    key = dataset or guess_dataset(layout, place.name, place.parent.name)
    convention = camera_convention or by.convention
    if convention not in CONVENTIONS:
        text = f"the camera convention is {shorten(repr(convention), 40)}; it must be "
        raise SceneError("SCENE_ARGUMENT", text + " or ".join(CONVENTIONS))
    wish = None if resolution is None else check_resolution(resolution)
    color = evaluation_background(key) if rules == OURS else by.background_of(key)
    warnings: list[Finding] = []
    chosen, how = choose_photographs(root, key, layout, place.name, by, image_folder, wish, warnings)
    files = SpelledFiles(root / chosen.folder)
    views = [
        replace(view, image_path=files.find(str(view.name)))
        for view in read_views(root, layout, by, chosen.folder)
    ]
    native = photograph_sizes(root, views, warnings)
    masks = (None, {}) if chosen.compositing == "none" else find_masks(root, key, views)
    rounding = ROUNDINGS[how]
    cameras = [
        view.resized(*rounding(size, chosen.resolution)) for view, size in zip(views, native, strict=True)
    ]
    resized = any((c.width, c.height) != size for c, size in zip(cameras, native, strict=True))
    if convention == "gs_fov":
        warnings += _shifted(root, cameras)
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
        background=color if background is None else _color(background),
        camera_convention=convention,
        compositing="none" if masks[0] is None else chosen.compositing,
        mask_source=masks[0],
        masks=masks[1],
        resampling=by.resampling,
        quantized=by.quantized,
        gt_resized=resized,
        warnings=tuple(warnings),
    )


def dataset_of(path: str | os.PathLike[str]) -> str:
    """Return the dataset of a scene, told by the names of its folder and the one above it."""
    root = given_path(path)
    layout, place = _layout(root), _place(root)
    return guess_dataset(layout, place.name, place.parent.name)


def _place(root: Path) -> Path:
    return Path(os.path.abspath(root))  # noqa: PTH100 - names as given, not where links lead


def _layout(root: Path) -> Layout:
    """Return how the scene at `root` is laid out; refuse what is none."""
    check_folder(root)
    layout = find_layout(root)
    if layout is None:
        scenes = find_scenes(root)  # refuses a folder without any
        names = ", ".join(scene.relative_to(root).as_posix() for scene in scenes[:4])
        text = f"it is no scene but holds {len(scenes)}: {shorten(names)}; give one of them"
        raise SceneError("SCENE_LAYOUT", text, file=root)
    return layout


def rules_of(name: str) -> Rules:
    """Return the rules of this name."""
    if name not in RULES:
        text = f"there are no rules {shorten(repr(name), 40)}; there are {', '.join(RULES)}"
        raise SceneError("SCENE_ARGUMENT", text)
    return RULES[name]


def _color(values: Sequence[float]) -> Color:
    if len(values) != 3 or not all(0 <= value <= 1 for value in values):
        text = f"the background is {shorten(repr(values), 60)}; it must be red, green and blue from 0 to 1"
        raise SceneError("SCENE_ARGUMENT", text)
    red, green, blue = map(float, values)
    return red, green, blue


def _shifted(root: Path, cameras: Sequence[Camera]) -> list[Finding]:
    """Return a warning if the middle of the image is visibly not the principal point."""
    far = max(max(abs(c.cx - c.width / 2), abs(c.cy - c.height / 2)) for c in cameras)
    if far <= MAX_SHIFT:
        return []
    text = (
        f"the recorded principal point is up to {far:.1f} pixels off the middle, where gs_fov puts it; "
        "checkpoints trained with it need camera_convention full_K"
    )
    return [finding("SCENE_PRINCIPAL_POINT", text, severity="warning", file=str(root), value=far)]


@dataclass(frozen=True)
class SceneAt:
    """A scene on which a method is evaluated: the arguments of `read_scene`, and its name in the results."""

    dataset: str
    name: str
    path: Path
    image_folder: str | None
    resolution: int | None
    background: Color
    camera_convention: Convention

    @lru_cache(maxsize=8)  # noqa: B019 - a few are kept as long as they are the last
    def read(self) -> Scene:
        """Return the scene; the last few are kept."""
        return read_scene(**{key: value for key, value in vars(self).items() if key != "name"})


def scene_at(
    path: Path,
    dataset: str,
    method: str,
    *,
    own_background: Color | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    background: Color | None = None,
    camera_convention: Convention | None = None,
) -> SceneAt:
    """Return how a method is evaluated on a scene, of whose folder nothing is read yet.

    `own_background` is that of the method's official evaluation, if the model records it. The last four are
    asked for instead of the rules, as for `read_scene`: the size is else that of our rules, the camera the
    one the method is trained with, the background that of `evaluation_background`.
    """
    return SceneAt(
        dataset=dataset,
        name=path.name,
        path=path,
        image_folder=image_folder,
        resolution=resolution,
        background=background or evaluation_background(dataset, method, own_background),
        camera_convention=camera_convention or RULES.get(method, RULES[OURS]).convention,
    )


def scene_of(
    manifest: Manifest,
    path: str | os.PathLike[str],
    *,
    image_folder: str | None = None,
    resolution: int | None = None,
) -> Scene:
    """Return the scene of a folder as the method of a model is evaluated on it; raises as `read_scene`."""
    place, own = given_path(path), stated_background(manifest)
    at = scene_at(
        place,
        dataset_of(place),
        manifest.method,
        own_background=own,
        image_folder=image_folder,
        resolution=resolution,
    )
    return at.read()
