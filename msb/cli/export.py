"""`msb export`: a trained checkpoint as a .triasset, without torch."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.cli.options import WRITTEN, Force, JsonFile, Quiet, Verbose, epilog
from msb.cli.output import Output, plain_table, setting_text

if TYPE_CHECKING:
    from msb.asset import Asset

EPILOG = epilog(
    "msb export data_stubs/checkpoint",
    "msb export data_stubs/checkpoint out/demo.triasset",
    "msb export --set opacity_floor=0.9999 data_stubs/checkpoint out/f.triasset",
    "msb export --json - --quiet data_stubs/checkpoint out/quiet.triasset",
)
SCHEMA = "msb.export/1"


def export(
    source: Annotated[
        Path, typer.Argument(metavar="CHECKPOINT", help="A training's output folder, or the model's file.")
    ],
    target: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT", help="The .triasset to write. Default: named like CHECKPOINT, in this folder."
        ),
        WRITTEN,
    ] = None,
    method: Annotated[
        str | None, typer.Option(metavar="NAME", help="The method that you expect; detected if not given.")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Override a setting; msb methods lists them."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML config or log of a 2DTS training.")
    ] = None,
    form: Annotated[Literal["packed", "folder"], typer.Option(help="Form of the .triasset.")] = "packed",
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Turn a trained checkpoint into a .triasset, on any machine: no PyTorch, no CUDA.

    The method is found from what the files hold. Settings come from the checkpoint, the training's
    config, --set, or defaults; the asset records which.
    """
    from msb.adapters.exporter import finish, read_model
    from msb.adapters.locate import locate
    from msb.api.saving import checked_ending
    from msb.asset import ASSET_SUFFIX, write_asset

    output = Output(json_file, quiet, verbose, force)
    place = locate(source)
    target = target or Path(place.name + ASSET_SUFFIX)
    checked_ending(target, "OUT", (ASSET_SUFFIX,))
    output.check_free(target, folder=form == "folder")
    output.check_free(json_file)
    with output.progress(f"reading {source.name}"):
        model = read_model(place, method=method, settings=assignments or (), config=config)
    with output.bars() as progress:
        asset = finish(model, progress=progress)
        write_asset(asset, target, form, progress=progress)
    for warning in asset.warnings:
        output.note(warning.to_line(source))
    manifest = asset.manifest.to_dict()
    warnings = [warning.to_dict() for warning in asset.warnings]
    output.write_json({"schema": SCHEMA, "path": str(target), "warnings": warnings, "manifest": manifest})
    if output.prints_text:
        _print(asset, target, output)


def _print(asset: Asset, target: Path, output: Output) -> None:
    from rich.markup import escape

    from msb.registry import lookup

    m, console = asset.manifest, output.console()
    size = sum(spec.byte_length for spec in m.buffers.values())
    console.print(
        f"{escape(str(target))}: [bold]{lookup(m.method).title}[/bold], {m.topology.replace('_', ' ')}, "
        f"{m.vertex_count:,} vertices, {m.face_count:,} faces, SH degree {m.sh_degree}, {size:,} bytes",
        soft_wrap=True,
    )
    if output.quiet or not m.settings:
        return
    table = plain_table("Setting", "Value", "From")
    for name, stored in m.settings.items():
        table.add_row(name, escape(setting_text(stored.value)), stored.source)
    console.print(table)
