"""`msb bake`: a plain asset that looks like the model, taught by the model's own renderer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msb.bake.options import BakeOptions
from msb.base.option import Option
from msb.cli.command import Typed, command, require
from msb.cli.output import JsonOutput, Output, echo, is_stdout
from msb.errors import one_line
from msb.render.options import NO_CAMERAS, Drawing, ImageFolder, Source, Views

if TYPE_CHECKING:
    from msb.bake import Baked
    from msb.bake.report import Report
    from msb.scenes.datasets import Scene


# Geometry -> what becomes of what no view sees.
_UNSEEN = {
    "kept": "stays as it was",
    "fitted": "stays as it was where faces were to spare",
    "surface": "the surface is closed there",
}


@dataclass(frozen=True)
class BakeFiles:
    """Where the mesh is written, and the scene it is made for."""

    outputs: Annotated[
        tuple[Path, ...],
        Option(
            "What to write: .glb, .triasset, .obj or another format, and may be given again; or a folder: a "
            "name without an ending.",
            ("--out", "-o"),
            metavar="OUT",
            output="own",
        ),
    ] = ()
    scene: Annotated[
        Path | None,
        Option(
            "The scene it was trained on, as msb run reads it: its training views teach, its test views are "
            "for the numbers alone.",
            metavar="DIR",
        ),
    ] = None
    image_folder: ImageFolder = None


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
    options: BakeOptions,
    views: Annotated[Views, ("cameras", "size", "background")],
    drawing: Annotated[Drawing, ("device",)],
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Make a plain asset that looks like a model: opaque, with a texture or colours that any engine shows.

    The model's own renderer teaches it, in the views of --scene or --cameras, else of its training where they
    lie beside it, else in views round it. What is printed is measured in views that taught nothing: dB to
    photographs with --scene, else to the model's own look.

    A folder has what an artist wants: asset.glb, what --lods and --collision make beside it, bake.json (what
    --json writes), preview.png, and index.html, a page to look at all of it. Of a folder that is there only
    what a bake wrote is replaced.
    """
    require(files.outputs, "Missing output. Pass -o with the file to write, for example -o model.glb")
    _check_files(files, views, typed)
    from msb.api.command_files import open_asset
    from msb.bake import bake as make
    from msb.bake.folder import PAGE, only_folder
    from msb.bake.written import endings, places
    from msb.scenes.datasets import scene_of

    folder = None
    if only_folder(files.outputs) and not is_stdout(files.outputs[0]):
        folder = files.outputs[0]
        output.check_folder(folder)
    else:
        names = endings(len(options.shares), has_collision=options.collision is not None)
        for place in places(files.outputs, names):
            output.check_free(place)
    asset = open_asset(path, output)
    cameras = None if views.cameras is None else views.read(output.note)
    scene: Scene | Path | None = files.scene
    if files.scene is not None and files.image_folder is not None:
        scene = scene_of(asset.manifest, files.scene, image_folder=files.image_folder)
    with output.bars("steps") as progress:
        baked = make(
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
        _show(report, files.outputs, output)
        if folder is not None and (folder / PAGE).exists() and not output.quiet:
            echo(f"{one_line(str(folder / PAGE))}: a page to look at it")


def _check_files(files: BakeFiles, views: Views, typed: Typed) -> None:
    """Reject options that contradict each other."""
    if files.scene is not None:
        typed.reject(["cameras"], "does not go with --scene, which has its own cameras")
    else:
        typed.reject(["image_folder"], "needs --scene DIR")
    if views.cameras is None:
        typed.reject(["size"], NO_CAMERAS)
    if files.scene is not None or views.cameras is not None:
        typed.reject(["up"], "is for generated views, without --scene and --cameras")


def _note_losses(baked: Baked, paths: tuple[Path, ...], output: Output) -> None:
    """Say what a format has no place for."""
    from msb.asset import ASSET_SUFFIX
    from msb.meshes.assets import as_held, mesh_from_asset
    from msb.meshes.losses import losses

    mesh = mesh_from_asset(baked.asset)
    for path in paths:
        suffix = path.suffix.lower()
        if suffix != ASSET_SUFFIX:
            for text in losses(mesh, as_held(mesh, suffix), suffix, ()):
                output.note(f"{path}: {text}")


def _show(report: Report, paths: tuple[Path, ...], output: Output) -> None:
    """Print the numbers, and what else should be known."""
    names = ", ".join(one_line(str(path)) for path in paths)
    echo(f"{names}: {report.sentence}")
    if output.quiet:
        return
    views = f"{report.taught} view{'s' if report.taught != 1 else ''}"
    if report.between:
        views = f"{views} and {report.between} between them"
    echo(f"taught by {views}, {report.teacher}: {one_line(report.views)}")
    for level in report.lods:
        echo(f"{one_line(str(level.output))}: {level.said}")
    if (shape := report.collision) is not None:
        echo(f"{one_line(str(shape.output))}: {shape.said}")
        if shape.why:
            output.note(shape.why)
    if report.unseen_area:
        became = _UNSEEN[report.geometry]
        echo(f"{100 * report.unseen_area:.1f} % of the model's area is in no view, and {became}")
    for text in report.notes:
        output.note(text)
