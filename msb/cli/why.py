"""`msb why`: what each cause of a worse look costs an asset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from msb.cli.camera_options import Assignments, Background, Cameras, Chosen, Scale, Size
from msb.cli.options import WRITTEN, DeviceName, Force, JsonFile, Quiet, Verbose, epilog, refuse
from msb.cli.output import Output, plain_table

if TYPE_CHECKING:
    from msb.why import Cause

EPILOG = epilog(
    "msb why --size 160x120 data_stubs/models/pebble/two_dts",
    "msb why --cameras data_stubs/views.json --scale 0.25 --save out/why \\\n      data_stubs/checkpoint",
)
SCHEMA = "msb.why/1"


def why(
    path: Annotated[Path, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")],
    cameras: Cameras = None,
    chosen: Chosen = None,
    size: Size = None,
    scale: Scale = None,
    background: Background = None,
    assignments: Assignments = None,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save", metavar="FOLDER", help="Write a picture of each cause: without it, and with it."
        ),
        WRITTEN,
    ] = None,
    device: DeviceName = None,
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Say why an export looks worse than the render: what each cause costs, in dB.

    The asset is drawn with each cause and without it, everything else alike. Below 30 dB the difference is
    plain to see, above 40 dB it is not. Without --cameras eight views around the asset are drawn.
    """
    from msb.asset.settings import parse_overrides
    from msb.cli.camera_options import cameras_at, parse_background, parse_size
    from msb.cli.inputs import open_asset
    from msb.errors import about
    from msb.scenes.around import around
    from msb.why import CAUSES, TURNTABLE
    from msb.why import why as find

    output = Output(json_file, quiet, verbose, force)
    output.check_free(json_file)
    if save is not None:
        for known in CAUSES:
            output.check_free(save / f"{known.name}.png")
    if cameras is None:
        refuse({"camera": chosen, "scale": scale}, "needs --cameras PATH")
    with output.progress(f"reading {path.name}"):
        asset = open_asset(path, output)
    if cameras is None:
        count, width, height = TURNTABLE
        views = around(asset, count, *(parse_size(size) if size else (width, height)))
    else:
        views = cameras_at(cameras, chosen, size, scale, output)
    color = parse_background(background, asset)
    with output.counted("drawing", len(CAUSES)) as step, about(path):
        causes = find(
            asset,
            views,
            background=color,
            settings=dict(parse_overrides(asset.manifest.method, assignments or [])),
            device=device,
            step=step,
        )
    where: dict[str, Any] = {"views": len(views), "cameras": "turntable" if cameras is None else cameras}
    where["background"] = list(color)
    head = {"schema": SCHEMA, "path": str(path), "method": asset.manifest.method, **where}
    output.write_json({**head, "causes": [cause.to_dict() for cause in causes]})
    if save is not None:
        _save(causes, save)
    if output.prints_text:
        _print(causes, head, save, output)


def _save(causes: list[Cause], folder: Path) -> None:
    import numpy as np

    from msb.render.images import write_image

    for cause in causes:
        if cause.without is not None and cause.with_it is not None:
            gap = np.ones((len(cause.without), 4, 3), np.float32)
            picture = np.concatenate([cause.without, gap, cause.with_it], axis=1)
            write_image(folder / f"{cause.name}.png", picture, "png")


def _print(causes: list[Cause], head: dict[str, Any], save: Path | None, output: Output) -> None:
    from rich.markup import escape

    from msb.why import EQUAL

    console = output.console()
    views = f"{head['views']} view{'' if head['views'] == 1 else 's'} " + (
        "around it" if head["cameras"] == "turntable" else "given"
    )
    console.print(f"[bold]{escape(head['path'])}[/bold]: {head['method']}, {views}")
    table = plain_table("Cause", "dB", "" if output.quiet else "How to see whether it is yours", right=(1,))
    shown = sorted((one for one in causes if one.db is not None), key=lambda one: one.db or 0.0)
    for cause in shown:
        db = "equal" if cause.db is None or cause.db >= EQUAL else f"{cause.db:.1f}"
        table.add_row(cause.title, db, "" if output.quiet else escape(cause.how_to_see))
    console.print(table)
    if save is not None and not output.quiet:
        console.print(f"pictures, each without and with its cause: {escape(str(save))}", soft_wrap=True)
    absent = [one for one in causes if not one.applies]
    if absent and not output.quiet:
        console.print("\nNot causes here:")
        for cause in absent:
            console.print(f"- {escape(cause.title)}: {escape(str(cause.reason))}")
