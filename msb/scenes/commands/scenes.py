"""`msb scenes`: list the scenes found in folders, and describe how they would be evaluated."""

import contextlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from msb.base.option import Argument, Option
from msb.cli.command import command, option_value
from msb.cli.output import ManyOutput, Output, echo, report_error
from msb.errors import MsbError, UsageError, shorten
from msb.render.options import SceneOptions
from msb.scenes import Camera
from msb.scenes.datasets import Scene, SceneReport


@dataclass(frozen=True)
class ScenesOptions:
    """Options for the rules of reading a scene, and for an undistorted copy."""

    undistort: Annotated[
        Path | None,
        Option(
            "Write the scene to OUT as a COLMAP scene for other programs: upright, undistorted, losslessly "
            "stored colour images, pinhole cameras, masks, points and the recorded split.",
            metavar="OUT",
            output="folder",
        ),
    ] = None

    rules: Annotated[
        str,
        Option(
            "Read the scene like the official code of method NAME. The value ours reads it like msb run.",
            metavar="NAME",
        ),
    ] = "ours"


@command(
    "msb scenes data_stubs/scenes",
    "msb scenes data_stubs/scenes/dtu/scan1",
    "msb scenes --image-folder images_2 data_stubs/scenes/mipnerf360",
    "msb scenes --json - --rules two_dts data_stubs/scenes/nerf_synthetic/pebble",
    "msb scenes --undistort out/undistorted data_stubs/scenes/dtu/scan1",
)
def scenes(
    paths: Annotated[tuple[Path, ...], Argument("Scenes, or folders of scenes.", metavar="PATH...")],
    reading: SceneOptions,
    options: ScenesOptions,
    output: ManyOutput,
) -> None:
    """List the scenes found, their photographs and missing files.

    Describe a single scene in full. List several scenes in a table; describe them in full with -v. Only the
    headers of images are read. The layouts and the rules are explained in docs/datasets.md.
    """
    from msb.scenes.datasets import describe_scene, find_scenes
    from msb.scenes.datasets.read import rules_of
    from msb.scenes.datasets.rules import check_resolution

    with option_value("--rules"):
        rules_of(options.rules)
    with option_value("--resolution"):
        check_resolution(1 if reading.resolution is None else reading.resolution)
    if options.undistort is not None:
        if len(paths) != 1:
            raise UsageError("USAGE", f"--undistort needs one scene; {len(paths)} paths are given")
        output.add_inputs(paths)
        _undistort(paths[0], options.undistort, reading, output)
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
                reports.append(
                    describe_scene(
                        place, rules=options.rules, converts=options.undistort is not None, **reading.given
                    )
                )
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


def _undistort(path: Path, folder: Path, reading: SceneOptions, output: Output) -> None:
    """Write an undistorted copy of a scene to a new folder."""
    from msb.metrics.ground_truth import read_photograph, read_photograph_mask
    from msb.scenes import read_points, read_scene
    from msb.scenes.colmap import find_model
    from msb.scenes.write_capture import write_capture

    output.check_folder(folder)
    options = {"resolution": 1, **reading.given}
    scene = read_scene(path, converts=True, **options)
    if scene.gt_resized:
        text = "needs full-size photographs; omit --resolution, and choose a dataset that keeps the size"
        raise UsageError("USAGE", f"--undistort {text}")
    for warning in scene.warnings:
        output.note(warning.to_line(warning.file or path))
    model = find_model(path) if scene.layout == "colmap" else None
    points = None
    with contextlib.suppress(MsbError):  # the description of the scene already reports unreadable points
        points = None if model is None else read_points(model)
    with output.counted("undistorting", len(scene.train) + len(scene.test)) as step:
        write_capture(
            scene, folder, points, read_photograph, read_photograph_mask, step, overwrite=output.force
        )
    if output.prints_text:
        echo(f"{folder}: {len(scene.train) + len(scene.test)} undistorted images and their cameras")


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
        # The table has no paths, so the notes contain the paths of scenes.
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
    """Return rows (label, text) about a scene that can be evaluated."""
    from msb.scenes.datasets import DATASETS, color_name

    first = scene.test[0]
    place = "at the paths in the JSON files" if scene.image_folder == "." else scene.image_folder
    how = f"resized {scene.resampling}" if scene.gt_resized else "as stored"
    split = "every 8th is a test view"
    if scene.split == "recorded":
        split = "split by the JSON files" if scene.layout == "blender" else "split as recorded"
    masks = {
        "png_alpha": "alpha channel of the photographs",
        "mask_folder": "image files in a folder",
        "mask_path": "image files that the JSON file names",
        None: "none",
    }[scene.mask_source]
    if scene.mask_source:
        masks += f"; composited with the background {scene.compositing.replace('_', ' ')}"
    fixed = scene.dataset in DATASETS and DATASETS[scene.dataset].background is not None
    behind = "for every method" if fixed else "unless the method has another background"
    # Count the lenses that differ. Two views share a lens if their recorded image sizes and relative focal
    # lengths are equal.
    views = {
        (view.source_size or (view.width, view.height), view.fx / view.width, view.fy / view.height)
        for view in (*scene.train, *scene.test)
    }
    recorded = scene.lens or first
    kind = "pinhole" if recorded.distortion is None else f"{recorded.distortion.model}"
    lens = (
        f"{len(views)} {kind} camera{'' if len(views) == 1 else 's'}, recorded at "
        f"{recorded.width} x {recorded.height}"
    )
    if recorded.distortion is not None:
        lens += ", undistorted"
    angles = f"{math.degrees(first.fov_x):.1f} x {math.degrees(first.fov_y):.1f} degrees"
    upward = ", ".join(f"{round(value, 3) + 0.0:.3f}" for value in scene.up)
    return [
        ("rules", scene.rules),
        ("views", f"{len(scene.train)} training, {len(scene.test)} test; {split}"),
        ("photographs", f"{place}, {how}, compared at {_size(first)}"),
        ("masks", masks),
        ("background", f"{color_name(scene.background)}, {behind}"),
        ("cameras", f"{lens}, {angles}, {scene.camera_convention}"),
        ("up", f"{upward} in the world of the cameras"),
    ]


def _list_deviations(report: SceneReport) -> list[tuple[str, str]]:
    """Return table rows that describe how the official code of each method reads the scene.

    Methods with equal differences are listed in one row.
    """
    grouped: dict[tuple[str, ...], list[str]] = {}
    for name, texts in report.deviations.items():
        if texts:
            grouped.setdefault(texts, []).append(name)
    return [("official", f"{', '.join(names)}: {'; '.join(texts)}") for texts, names in grouped.items()]


def _size(camera: Camera) -> str:
    return f"{camera.width} x {camera.height}"
