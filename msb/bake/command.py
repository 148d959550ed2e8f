"""`msb bake`: an opaque mesh that looks like the native rendering of a model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msb.bake.options import BakeOptions
from msb.base.option import Option
from msb.cli.command import Typed, command, require
from msb.cli.output import JsonOutput, Output, echo, is_stdout
from msb.errors import one_line
from msb.render.options import (
    NO_CAMERAS,
    NO_SCENE,
    SCENE_OPTIONS,
    RendererOptions,
    SceneOptions,
    Source,
    ViewOptions,
)

if TYPE_CHECKING:
    from msb.bake import Baked
    from msb.bake.report import Report
    from msb.scenes.datasets import Scene


# For each geometry, describe the treatment of surfaces that no training view shows.
_UNSEEN = {
    "kept": "a triangle soup loses this area; a connected mesh keeps its old colours in this area",
    "fitted": "triangles there are dropped",
    "surface": "a closed surface covers this area without images",
}


@dataclass(frozen=True)
class BakeFiles:
    """The outputs of a bake, and the scene that the model was trained on."""

    outputs: Annotated[
        tuple[Path, ...],
        Option(
            "Write to OUT: a .glb, .triasset, .obj or another mesh file, or a folder (a name without a "
            "suffix). Repeat the option to write several formats.",
            ("--out", "-o"),
            metavar="OUT",
            output="own",
        ),
    ] = ()
    size: Annotated[
        str | None,
        Option(
            "Size of the --cameras images in pixels, or a scale factor for the size of the cameras.",
            metavar="WxH|FACTOR",
        ),
    ] = None
    scene: Annotated[
        Path | None,
        Option(
            "Use the views of the scene that the model was trained on. Training views supervise; test views "
            "are held out for the measurement.",
            metavar="DIR",
        ),
    ] = None


@command(
    "msb bake --geometry kept --cameras data_stubs/views.json \\\n"
    "      data_stubs/checkpoint -o out/plain.glb",
    "msb bake --scene data_stubs/scenes/nerf_synthetic/pebble \\\n"
    "      data_stubs/models/pebble/triangle_splatting -o out/pebble.glb",
    "msb bake --for-solid --lods 0.5,0.25,0.1 --collision mesh:1000 \\\n"
    "      --scene data_stubs/scenes/nerf_synthetic/pebble \\\n"
    "      data_stubs/models/pebble/two_dts -o out/pebble",
)
def bake(
    path: Source,
    files: BakeFiles,
    reading: SceneOptions,
    options: BakeOptions,
    views: Annotated[ViewOptions, ("cameras", "background")],
    drawing: Annotated[RendererOptions, ("device",)],
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Make an opaque mesh, with a texture or vertex colours, that looks like the native rendering of a model.

    The mesh is fitted to native renderings of the model in the views of --scene or --cameras. If neither
    --scene nor --cameras is given, the views are the training cameras beside the model, or generated views.
    The printed PSNR is measured on held-out views. With --scene, photographs are the reference images.
    Without --scene, native renderings are the reference images.

    An output folder contains asset.glb with its levels of detail and its collision shape, bake.json (the
    output of --json), preview.png, and index.html, a page with all results. In an existing folder, only files
    of an earlier bake are replaced.
    """
    require(files.outputs, "Missing output. Pass -o with the file to write, for example -o model.glb")
    _check_files(files, views, typed)
    views = replace(views, size=files.size)
    from msb.api.command_files import open_asset
    from msb.bake import bake as run_bake
    from msb.bake.folder import PAGE, is_folder_output
    from msb.bake.output_files import list_endings, list_output_files
    from msb.scenes.datasets import scene_of

    # Check all output paths before the bake starts.
    folder = None
    if is_folder_output(files.outputs) and not is_stdout(files.outputs[0]):
        folder = files.outputs[0]
        output.check_folder(folder)
    else:
        endings = list_endings(len(options.lod_shares), has_collision=options.collision is not None)
        for place in list_output_files(files.outputs, endings):
            output.check_free(place, label="--out")
    asset = open_asset(path, output)
    cameras = None if views.cameras is None else views.read(output.note)
    scene: Scene | Path | None = files.scene
    if files.scene is not None:
        scene = scene_of(asset.manifest, files.scene, **reading.given)
    with output.bars("steps") as progress:
        baked = run_bake(
            asset,
            scene=scene,
            cameras=cameras,
            background=None if views.background is None else views.color(asset),
            device=drawing.device,
            progress=progress,
            **vars(options),
        )
    report = baked.save(*files.outputs, overwrite=output.force)
    output.write_json({**report.to_dict(), "path": str(path)})
    if folder is None:
        _note_losses(baked, files.outputs, output)
    if output.prints_text:
        _print_report(report, files.outputs, output)
        if folder is not None and (folder / PAGE).exists() and not output.quiet:
            echo(f"Open {one_line(str(folder / PAGE))} in a browser to view the result")


def _check_files(files: BakeFiles, views: ViewOptions, typed: Typed) -> None:
    """Reject options that contradict each other."""
    if files.scene is not None:
        typed.reject(["cameras"], "cannot be combined with --scene, because the scene has cameras")
    else:
        typed.reject(SCENE_OPTIONS, NO_SCENE)
    if views.cameras is None:
        typed.reject(["size"], NO_CAMERAS)
    if files.scene is not None or views.cameras is not None:
        typed.reject(["views"], "applies only to generated views, which --scene and --cameras replace")


def _note_losses(baked: Baked, paths: tuple[Path, ...], output: Output) -> None:
    """Print a note for each property of the mesh that a format cannot store."""
    from msb.asset import ASSET_SUFFIX
    from msb.meshes.assets import fit_to_format, mesh_from_asset
    from msb.meshes.losses import describe_placement, list_losses

    mesh = mesh_from_asset(baked.asset)
    for path in paths:
        suffix = path.suffix.lower()
        if suffix != ASSET_SUFFIX:
            for text in list_losses(mesh, fit_to_format(mesh, suffix), suffix, ()):
                output.note(f"{path}: {text}")
            for text in describe_placement(fit_to_format(mesh, suffix), suffix):
                output.note(f"{path}: {text}")


def _print_report(report: Report, paths: tuple[Path, ...], output: Output) -> None:
    """Print the result, the views, the levels of detail, the collision shape and the notes."""
    names = ", ".join(one_line(str(path)) for path in paths)
    echo(f"{names}: {report.sentence}")
    if output.quiet:
        return
    count = report.training + report.validation
    views = f"{count} training view{'s' if count != 1 else ''}"
    if report.interpolated:
        views = f"{views} plus {report.interpolated} interpolated views"
    images = "native renderings" if report.supervision == "native" else "photographs"
    echo(f"Baked from {images} of {views}. Source of the views: {one_line(report.views)}")
    if report.shape is not None:
        echo(report.shape.sentence)
    for lod in report.lods:
        echo(f"{one_line(str(lod.output))}: {lod.sentence}")
    if (shape := report.collision) is not None:
        echo(f"{one_line(str(shape.output))}: {shape.sentence}")
        if shape.why:
            output.note(shape.why)
    if report.unseen_area:
        share = 100 * report.unseen_area
        size = f"{share:.1f} %" if share >= 0.05 else "Less than 0.1 %"
        echo(f"{size} of the model's area is visible in no training view; {_UNSEEN[report.geometry]}")
    for text in report.notes:
        output.note(text)
