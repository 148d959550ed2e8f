"""Describe a scene's folder: its content, its used files, and deviations of official code."""

import contextlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from msb.base.files import is_file
from msb.errors import Finding, MsbError, error_finding, finding
from msb.scenes.camera import Camera
from msb.scenes.colmap import find_model, read_points
from msb.scenes.colmap_models import MODELS
from msb.scenes.colors import NAMED
from msb.scenes.datasets.catalog import DATASETS, Layout
from msb.scenes.datasets.layout import TRAIN, find_layout, folders, images_in
from msb.scenes.datasets.neus import MATRICES
from msb.scenes.datasets.photographs import MASKS
from msb.scenes.datasets.read import dataset_of, missing_photographs, read_scene
from msb.scenes.datasets.rulebook import OURS, RULES
from msb.scenes.datasets.rules import Size
from msb.scenes.datasets.scene import Scene
from msb.scenes.image_size import image_size


@dataclass(frozen=True)
class ImageFolder:
    """A folder of photographs, with the number of used photographs and the size of the first photograph."""

    name: str
    images: int
    used: int
    size: Size | None


@dataclass(frozen=True)
class SceneReport:
    """The content of a scene's folder. Either `scene` or `error` is None.

    `points` is the number of SfM points. If the points cannot be read, the value is None. `unused` lists each
    unused file with the reason. `deviations` lists the differences between our rules and each method's
    official code. `missing` counts the missing photographs of "training" and "test" views. If the cameras
    cannot be read, the value is None.
    """

    path: Path
    dataset: str
    name: str
    layout: Layout
    scene: Scene | None
    error: MsbError | None
    image_folders: tuple[ImageFolder, ...]
    points: int | None
    missing: dict[str, int] | None
    findings: tuple[Finding, ...]
    unused: tuple[str, ...]
    deviations: dict[str, tuple[str, ...]]

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        error = self.error
        return {
            "path": str(self.path),
            "dataset": self.dataset,
            "scene": self.name,
            "layout": self.layout,
            "error": None if error is None else {"code": error.code, "message": error.message},
            "evaluated": None if self.scene is None else _describe_evaluation(self.scene),
            "points": self.points,
            **_describe_capture(self.scene),
            "missing": self.missing,
            "image_folders": [asdict(folder) for folder in self.image_folders],
            "warnings": [{"code": f.code, "file": f.file, "message": f.message} for f in self.findings],
            "unused": self.unused,
            "deviations": self.deviations,
        }


def _describe_capture(scene: Scene | None) -> dict[str, Any]:
    """Return JSON data about the lens, axes, masks and split of a capture.

    For a rejected capture, all values are None.
    """
    if scene is None or scene.lens is None:
        return dict.fromkeys(("lens", "up", "unit", "masks", "split"))
    return {
        "lens": describe_lens(scene.lens),
        "up": scene.up,
        "unit": "unknown",
        "masks": scene.mask_source,
        "split": scene.split,
    }


def describe_lens(camera: Camera) -> dict[str, Any]:
    """Return the model and parameters of a recorded camera as JSON data, in COLMAP's order.

    `undistorted` states that the photographs are undistorted when they are read.
    """
    model: str = "PINHOLE"
    coefficients: tuple[float, ...] = ()
    if camera.distortion is not None:
        model, coefficients = camera.distortion.model, camera.distortion.coefficients
    has_one_focal = model in MODELS and MODELS[model].focals == 1
    focals = (camera.fx,) if has_one_focal else (camera.fx, camera.fy)
    return {
        "model": model,
        "parameters": [*focals, camera.cx, camera.cy, *coefficients],
        "undistorted": camera.distortion is not None,
    }


def _describe_evaluation(scene: Scene) -> dict[str, Any]:
    """Return JSON data about how the scene is evaluated."""
    first = scene.test[0]
    return {
        "rules": scene.rules,
        "image_folder": scene.image_folder,
        "resolution": scene.resolution,
        "width": first.width,
        "height": first.height,
        "gt_resized": scene.gt_resized,
        "train": [camera.name for camera in scene.train],
        "test": [camera.name for camera in scene.test],
        "background": scene.background,
        "camera_convention": scene.camera_convention,
        "mask_source": scene.mask_source,
        "compositing": scene.compositing,
    }


def describe_scene(path: Path, **options: Any) -> SceneReport:
    """Return a report on the scene at `path`. The `options` are passed to `read_scene`.

    The path must be a folder that `find_layout` recognises. Errors about the scene's content are stored in
    the report instead of raised.
    """
    place, layout = path.absolute(), find_layout(path)
    if layout is None:
        raise ValueError(f"{path} is not a scene; use find_scenes to find scenes")
    scene: Scene | None = None
    problem: MsbError | None = None
    try:
        scene = read_scene(path, **options)
    except MsbError as error:
        problem = error
    # First describe the folder. A folder can be described even if its scene is invalid. Then describe the
    # evaluation of the scene.
    dataset = options.get("dataset") or dataset_of(path)
    images = _list_image_folders(path, scene)
    points, of_points = _count_points(path, layout)
    findings = [*(scene.warnings if scene else ()), *of_points]
    missing: dict[str, int] | None = None
    if scene is not None:
        missing = dict(scene.missing)
    else:
        with contextlib.suppress(MsbError):  # the cameras cannot be read, so their photographs are unknown
            missing = missing_photographs(path, **options)
    if scene is not None:
        findings += _check_view_count(scene)
    return SceneReport(
        path=path,
        dataset=dataset,
        name=place.name,
        layout=layout,
        scene=scene,
        error=problem,
        image_folders=images,
        points=points,
        missing=missing,
        findings=tuple(findings),
        unused=_list_unused(path, layout, scene, images),
        deviations=_list_deviations(path, scene, options) if scene else {},
    )


def _list_image_folders(root: Path, scene: Scene | None) -> tuple[ImageFolder, ...]:
    """Return the folders of a scene that contain images."""
    used: set[Path] = set()
    if scene is not None:
        views = (*scene.train, *scene.test)
        used = {path for view in views if (path := view.image_path) is not None} | set(scene.masks.values())
    holding = []
    for folder in folders(root):
        if images := images_in(folder):
            size: Size | None = None
            # errors of used images were reported when the scene was read
            with contextlib.suppress(MsbError):
                size = image_size(images[0])
            holding.append(ImageFolder(folder.name, len(images), len(used.intersection(images)), size))
    return tuple(holding)


def _count_points(root: Path, layout: Layout) -> tuple[int | None, list[Finding]]:
    """Return the number of SfM points. For a COLMAP scene without points, also return a warning."""
    model = find_model(root) if layout == "colmap" else None
    if model is None:
        return None, []
    try:
        return len(read_points(model)[0]), []
    except MsbError as error:
        problem = error_finding(error)
        return None, [finding(problem.code, problem.message, severity="warning", file=str(model))]


def _check_view_count(scene: Scene) -> list[Finding]:
    """Return a warning if a benchmark scene does not have the published number of views."""
    dataset = DATASETS.get(scene.dataset)
    counts = len(scene.train), len(scene.test)
    wanted = dataset.views if dataset is not None and scene.name in dataset.scenes else None
    if wanted is None or wanted == counts:
        return []
    text = "the scene has {} training and {} test views; {} and {} are published".format(*counts, *wanted)
    return [finding("SCENE_LAYOUT", text, severity="warning", file=str(scene.root), value=counts)]


def _list_unused(
    root: Path, layout: Layout, scene: Scene | None, images: tuple[ImageFolder, ...]
) -> tuple[str, ...]:
    """Return descriptions of image folders and files that the scene does not use."""
    if scene is None:
        return ()
    unused = []
    for folder in images:
        if not folder.used:
            size = "" if folder.size is None else f" of {folder.size[0]} x {folder.size[1]}"
            unused.append(f"{folder.name}: {folder.images} images{size}")
        elif folder.used < folder.images and folder.name != MASKS:
            unused.append(f"{folder.name}: {folder.images - folder.used} images without a camera")
    if layout == "colmap" and is_file(root / TRAIN):
        unused.append(f"{TRAIN}: the COLMAP model takes precedence")
    if is_file(root / "transforms_val.json"):
        unused.append("transforms_val.json: validation views are used neither for training nor for tests")
    if layout == "colmap" and is_file(root / MATRICES):
        unused.append(f"{MATRICES}: used only to scale meshes to millimetres; cameras are read from COLMAP")
    return tuple(unused)


def _list_deviations(root: Path, ours: Scene, options: dict[str, Any]) -> dict[str, tuple[str, ...]]:
    """For each method, return the differences between our rules and the method's official code."""
    given = {key: value for key, value in options.items() if key == "dataset"}
    deviations: dict[str, tuple[str, ...]] = {}
    for name in RULES:
        if name in (OURS, ours.rules):
            continue
        try:
            deviations[name] = tuple(_list_differences(ours, read_scene(root, rules=name, **given)))
        except MsbError as error:
            deviations[name] = (_explain_failure(error, ours.dataset),)
    return deviations


def _explain_failure(error: MsbError, dataset: str) -> str:
    """Return a short reason why the official code of a method rejects a scene that our rules accept."""
    if error.code == "SCENE_UNKNOWN":
        return f"no rule for {dataset}"
    if error.code == "SCENE_IMAGE_MISSING":
        return f"needs the folder{error.message.partition(';')[0].partition(' in')[2]}"
    return error.message


def _list_differences(ours: Scene, theirs: Scene) -> list[str]:
    """Return short descriptions of the differences between a scene read by two sets of rules."""
    first, second = ours.test[0], theirs.test[0]
    differences = []
    our_size, size = (f"{view.width} x {view.height}" for view in (first, second))
    # Compare the size and resampling of photographs, test split, intrinsics, background, masks and rounding.
    if (theirs.image_folder, size) != (ours.image_folder, our_size):
        how = f", resized ({theirs.resampling})" if theirs.gt_resized else ""
        place = "" if theirs.image_folder == "." else f"{theirs.image_folder} at "
        differences.append(f"{place}{size}{how}")
    elif theirs.gt_resized and theirs.resampling != ours.resampling:
        differences.append(f"resized {theirs.resampling}")
    if [view.name for view in theirs.test] != [view.name for view in ours.test]:
        differences.append("different test views")
    if _round_lens(first.resized(second.width, second.height)) != _round_lens(second):
        differences.append(
            "recorded principal point" if theirs.camera_convention == "full_K" else "different intrinsics"
        )
    if theirs.background != ours.background:
        differences.append(f"over {color_name(theirs.background)}")
    if ours.mask_source and theirs.mask_source is None:
        differences.append("mask ignored")
    if not theirs.quantized:
        differences.append("not rounded to 8 bits")
    return differences


def _round_lens(camera: Camera) -> tuple[float, ...]:
    """Return the intrinsics rounded to 1/1000 pixel, for comparison."""
    return tuple(round(value, 3) for value in (camera.fx, camera.fy, camera.cx, camera.cy))


def color_name(color: tuple[float, float, float]) -> str:
    """Return "white", "black", or the three numbers of a colour."""
    names = {value: name for name, value in NAMED.items()}
    return names.get(color, "(" + ", ".join(f"{value:g}" for value in color) + ")")
