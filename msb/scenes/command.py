"""`msb scenes`: the scenes found in folders, and how they would be evaluated."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from msb.base.option import Argument, Option
from msb.cli.command import command, option_value
from msb.cli.output import ManyOutput, Output, echo, report_error
from msb.errors import MsbError, shorten
from msb.scenes import Camera
from msb.scenes.datasets import Scene, SceneReport


@dataclass(frozen=True)
class ScenesOptions:
    """How to read the scenes."""

    dataset: Annotated[
        str | None,
        Option("mipnerf360, tanksandtemples, nerf_synthetic, dtu, or any other name.", metavar="NAME"),
    ] = None
    image_folder: Annotated[
        str | None, Option("Folder of photographs to use instead of the default.", metavar="NAME")
    ] = None
    resolution: Annotated[
        int | None,
        Option(
            "1, 2, 4 or 8 divides the size, -1 keeps it, any other number is the width in pixels.",
            ("--resolution", "-r"),
        ),
    ] = None
    rules: Annotated[
        str,
        Option(
            "Read the scene by the rules of this method's official code, or of msb run (ours).",
            metavar="NAME",
        ),
    ] = "ours"


@command(
    "msb scenes data_stubs/scenes",
    "msb scenes data_stubs/scenes/dtu/scan1",
    "msb scenes --image-folder images_2 data_stubs/scenes/mipnerf360",
    "msb scenes --json - --rules two_dts data_stubs/scenes/nerf_synthetic/pebble",
)
def scenes(
    paths: Annotated[tuple[Path, ...], Argument("Scenes, or folders of scenes.", metavar="PATH...")],
    options: ScenesOptions,
    output: ManyOutput,
) -> None:
    """List the scenes found, the photographs that are used, and missing files.

    A single scene is described in full. Several scenes are listed in a table, or with -v described in full.
    Only image headers are read. docs/datasets.md explains the layouts and the rules.
    """
    from msb.scenes.datasets import describe_scene, find_scenes
    from msb.scenes.datasets.read import rules_of
    from msb.scenes.datasets.rules import check_resolution

    with option_value("--rules"):
        rules_of(options.rules)
    with option_value("--resolution"):
        check_resolution(1 if options.resolution is None else options.resolution)
    status = 0
    reports: list[SceneReport] = []
    for path in paths:
        if output.fail_fast and (status or any(report.error for report in reports)):
            break
        try:
            places = find_scenes(path)
        except MsbError as error:
            status = max(status, report_error(error))
            continue
        output.add_inputs(places)
        with output.counted(f"reading {path.name}", len(places)) as step:
            for place in places:
                reports.append(describe_scene(place, **vars(options)))
                step()
                if output.fail_fast and reports[-1].error is not None:
                    break
    output.write_json({"schema": "msb.scenes/1", "scenes": [report.to_dict() for report in reports]})
    if output.prints_text and reports:
        _print(reports, output)
    for report in reports:
        if report.error is not None:
            status = max(status, report_error(report.error))
    raise typer.Exit(status)


def _print(reports: list[SceneReport], output: Output) -> None:
    """Print a single scene in full, or several scenes as a table with notes."""
    if len(reports) == 1 or output.verbose:
        for number, report in enumerate(reports):
            if number:
                echo()
            _print_one(report, output)
        return
    from msb.scenes.datasets import note_scaled_cameras

    rows = []
    for report in reports:
        scene = report.scene
        cells = ("--", "--", "--", report.error.code if report.error else "")
        if scene is not None:
            used = "RGBA PNG" if scene.mask_source == "png_alpha" else str(scene.image_folder)
            used += ", resized" if scene.gt_resized else ""
            cells = (str(len(scene.train)), str(len(scene.test)), _size(scene.test[0]), used)
        # The table has a column for the dataset, so the paths above the scenes appear only in the notes.
        rows.append((shorten(report.name, 40), shorten(report.dataset, 20), *cells))
    output.table(("Scene", "Dataset", "Train", "Test", "Size", "Photographs"), rows, right=(2, 3, 4))
    for report in reports:
        for warning in report.findings:
            output.note(warning.to_line(warning.file or report.path))
    if (
        note := note_scaled_cameras(report.scene for report in reports if report.scene is not None)
    ) is not None:
        output.note(note)


def _print_one(report: SceneReport, output: Output) -> None:
    """Print everything known about one scene."""
    from msb.scenes.datasets import note_scaled_cameras

    rows = [
        ("scene", str(report.path)),
        ("dataset", f"{report.dataset}, {report.name}, {_LAYOUTS[report.layout]}"),
    ]
    if report.scene is not None:
        rows += _describe(report.scene)
    else:
        rows += [("images", f"{f.name}: {f.images}") for f in report.image_folders]
    if report.missing is not None and any(report.missing.values()):
        counts = " and ".join(f"{count} {split}" for split, count in report.missing.items() if count)
        rows.append(("missing", f"{counts} photographs"))
    if report.points is not None:
        rows.append(("SfM points", f"{report.points:,}"))
    rows += [("not used", text) for text in report.unused]
    if not output.quiet:
        rows += [("warning", f"{w.code}: {w.message}") for w in report.findings]
        note = None if report.scene is None else note_scaled_cameras([report.scene])
        rows += [] if note is None else [("note", note)]
        rows += _list_deviations(report)
    output.table((), ((label, shorten(text, 300)) for label, text in rows))


_LAYOUTS = {
    "colmap": "COLMAP model in sparse",
    "blender": "transforms_train.json and transforms_test.json",
    "transforms": "transforms.json",
    "neus": "cameras.npz",
}


def _describe(scene: Scene) -> list[tuple[str, str]]:
    """Return (label, text) rows about a scene that can be evaluated."""
    from msb.scenes.datasets import DATASETS, color_name

    first = scene.test[0]
    place = "at the paths in the JSON files" if scene.image_folder == "." else scene.image_folder
    how = f"resized {scene.resampling}" if scene.gt_resized else "as stored"
    split = "split by the JSON files" if scene.layout == "blender" else "every 8th is a test view"
    masks = {
        "png_alpha": "alpha channel of the photographs",
        "mask_folder": "folder mask, one for each photograph",
        None: "none",
    }[scene.mask_source]
    if scene.mask_source:
        masks += f"; composited with the background {scene.compositing.replace('_', ' ')}"
    fixed = scene.dataset in DATASETS and DATASETS[scene.dataset].background is not None
    behind = "for every method" if fixed else "unless the method uses another"
    # Count the different lenses. A lens is its recorded image size and its focal lengths relative to the
    # image.
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


def _list_deviations(report: SceneReport) -> list[tuple[str, str]]:
    """Return rows on how official code reads the scene differently; methods that do the same share a row."""
    grouped: dict[tuple[str, ...], list[str]] = {}
    for name, texts in report.deviations.items():
        if texts:
            grouped.setdefault(texts, []).append(name)
    return [("official", f"{', '.join(names)}: {'; '.join(texts)}") for texts, names in grouped.items()]


def _size(camera: Camera) -> str:
    return f"{camera.width} x {camera.height}"
