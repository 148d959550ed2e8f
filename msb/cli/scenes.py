"""`msb scenes`: what was found in the folders of scenes, and how it would be evaluated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from msb.base.option import Argument, Option
from msb.cli.command import command
from msb.cli.failures import report_error
from msb.cli.output import ManyOutput, Output, echo
from msb.errors import MsbError, shorten

if TYPE_CHECKING:
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene, SceneReport

SCHEMA = "msb.scenes/1"


@dataclass(frozen=True)
class ScenesOptions:
    """How scenes are read."""

    dataset: Annotated[
        str | None,
        Option("mipnerf360, tanksandtemples, nerf_synthetic, dtu, or your own.", metavar="NAME"),
    ] = None
    image_folder: Annotated[
        str | None, Option("Folder of photographs instead of the usual one.", metavar="NAME")
    ] = None
    resolution: Annotated[
        int | None, Option("1, 2, 4, 8 divide the size; -1 keeps it; else a width.", ("--resolution", "-r"))
    ] = None
    rules: Annotated[str, Option("ours, or a method, to read as its official code does.", metavar="NAME")] = (
        "ours"
    )


@command(
    "msb scenes data_stubs/scenes",
    "msb scenes data_stubs/scenes/dtu/scan1",
    "msb scenes --image-folder images_8 data_stubs/scenes/mipnerf360",
    "msb scenes --json - --rules two_dts data_stubs/scenes/nerf_synthetic/pebble",
)
def scenes(
    paths: Annotated[tuple[Path, ...], Argument("Scenes, or folders of scenes.", metavar="PATH...")],
    options: ScenesOptions,
    output: ManyOutput,
) -> None:
    """Say what scenes were found, which photographs count, and what is missing.

    One scene is described in full, several in a table (with -v also in full). Only headers are decoded.
    docs/datasets.md shows the layouts and the rules.
    """
    from msb.scenes.datasets import describe_scene, find_scenes

    status = 0
    found: list[SceneReport] = []
    for path in paths:
        if output.fail_fast and (status or any(item.error for item in found)):
            break
        try:
            places = find_scenes(path)
        except MsbError as error:
            status = max(status, report_error(error))
            continue
        with output.counted(f"reading {path.name}", len(places)) as step:
            for place in places:
                found.append(describe_scene(place, **vars(options)))
                step()
                if output.fail_fast and found[-1].error is not None:
                    break
    output.write_json({"schema": SCHEMA, "scenes": [as_data(item) for item in found]})
    if output.prints_text and found:
        _print(found, output)
    for item in found:
        if item.error is not None:
            status = max(status, report_error(item.error))
    raise typer.Exit(status)


def as_data(item: SceneReport) -> dict[str, Any]:
    """Return a report as JSON data."""
    scene = item.scene
    return {
        "path": str(item.path),
        "dataset": item.dataset,
        "scene": item.name,
        "layout": item.layout,
        "error": None if item.error is None else {"code": item.error.code, "message": item.error.message},
        "evaluated": None if scene is None else _evaluated(scene),
        "points": item.points,
        "image_folders": [
            {
                "name": f.name,
                "images": f.count,
                "used": f.used,
                "size": None if f.size is None else list(f.size),
            }
            for f in item.image_folders
        ],
        "warnings": [{"code": w.code, "file": w.file, "message": w.message} for w in item.findings],
        "unused": list(item.unused),
        "deviations": {name: list(texts) for name, texts in item.deviations.items()},
    }


def _evaluated(scene: Scene) -> dict[str, Any]:
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
        "background": list(scene.background),
        "camera_convention": scene.camera_convention,
        "mask_source": scene.mask_source,
        "compositing": scene.compositing,
    }


def _print(found: list[SceneReport], output: Output) -> None:
    if len(found) == 1 or output.verbose:
        for number, item in enumerate(found):
            if number:
                echo()
            _print_one(item, output)
        return
    from msb.scenes.datasets import scaled_note

    rows = []
    for item in found:
        scene = item.scene
        cells = ("--", "--", "--", item.error.code if item.error else "")
        if scene is not None:
            used = "RGBA PNG" if scene.mask_source == "png_alpha" else str(scene.image_folder)
            used += ", resized" if scene.gt_resized else ""
            cells = (str(len(scene.train)), str(len(scene.test)), _size(scene.test[0]), used)
        # The dataset's name stands in its own column: what is above it is said once, in the notes.
        rows.append((shorten(item.name, 40), shorten(item.dataset, 20), *cells))
    output.table(("Scene", "Dataset", "Train", "Test", "Size", "Photographs"), rows, right=(2, 3, 4))
    for item in found:
        for warning in item.findings:
            output.note(warning.to_line(warning.file or item.path))
    if (note := scaled_note(item.scene for item in found if item.scene is not None)) is not None:
        output.note(note)


def _print_one(item: SceneReport, output: Output) -> None:
    from msb.scenes.datasets import scaled_note

    rows = [("scene", str(item.path)), ("dataset", f"{item.dataset}, {item.name}, {_LAYOUTS[item.layout]}")]
    if item.scene is not None:
        rows += _described(item.scene)
    else:
        rows += [("images", f"{f.name}: {f.count}") for f in item.image_folders]
    if item.points is not None:
        rows.append(("SfM points", f"{item.points:,}"))
    rows += [("not used", text) for text in item.unused]
    if not output.quiet:
        rows += [("warning", f"{w.code}: {w.message}") for w in item.findings]
        note = None if item.scene is None else scaled_note([item.scene])
        rows += [] if note is None else [("note", note)]
        rows += _deviating(item)
    output.table((), ((label, shorten(text, 300)) for label, text in rows))


_LAYOUTS = {
    "colmap": "COLMAP model in sparse",
    "blender": "transforms_train.json and transforms_test.json",
    "transforms": "transforms.json",
    "neus": "cameras.npz",
}


def _described(scene: Scene) -> list[tuple[str, str]]:
    from msb.scenes.datasets import DATASETS, color_name

    first = scene.test[0]
    place = "as the JSON files name them" if scene.image_folder == "." else scene.image_folder
    how = f"resized {scene.resampling}" if scene.gt_resized else "as stored"
    split = "by the JSON files" if scene.layout == "blender" else "every 8th is a test view"
    masks = {
        "png_alpha": "alpha channel of the photographs",
        "mask_folder": "folder mask, one for each photograph",
        None: "none",
    }[scene.mask_source]
    if scene.mask_source:
        masks += f"; laid over the background {scene.compositing.replace('_', ' ')}"
    fixed = scene.dataset in DATASETS and DATASETS[scene.dataset].background is not None
    behind = "for every method" if fixed else "unless the method's own is another"
    views = {
        (view.source_size or (view.width, view.height), view.fx / view.width, view.fy / view.height)
        for view in (*scene.train, *scene.test)
    }
    record = first.source_size or (first.width, first.height)
    lens = (
        f"{len(views)} pinhole camera{'' if len(views) == 1 else 's'}, recorded at {record[0]} x {record[1]}"
    )
    angles = f"{math.degrees(first.fov_x):.1f} x {math.degrees(first.fov_y):.1f} degrees"
    return [
        ("rules", scene.rules),
        ("views", f"{len(scene.train)} training, {len(scene.test)} test; {split}"),
        ("photographs", f"{place}, {how}, compared at {_size(first)}"),
        ("masks", masks),
        ("background", f"{color_name(scene.background)}, {behind}"),
        ("cameras", f"{lens}, {angles}, {scene.camera_convention}"),
    ]


def _deviating(item: SceneReport) -> list[tuple[str, str]]:
    """Return what methods do otherwise, those that do the same in one row."""
    grouped: dict[tuple[str, ...], list[str]] = {}
    for name, texts in item.deviations.items():
        if texts:
            grouped.setdefault(texts, []).append(name)
    return [("official", f"{', '.join(names)}: {'; '.join(texts)}") for texts, names in grouped.items()]


def _size(camera: Camera) -> str:
    return f"{camera.width} x {camera.height}"
