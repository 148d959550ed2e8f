"""`msb export`: convert a trained checkpoint to a .triasset, without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msb.base.option import Argument, Option
from msb.cli.command import command
from msb.cli.output import JsonOutput, Output, setting_text
from msb.render.options import RendererOptions

if TYPE_CHECKING:
    from msb.asset import Asset


@dataclass(frozen=True)
class ExportOptions:
    """The expected method, the configuration, and the form of the asset."""

    method: Annotated[
        str | None, Option("Expected method. Default: detected from the files.", metavar="NAME")
    ] = None
    config: Annotated[Path | None, Option("YAML config or text log of a 2DTS training.", metavar="FILE")] = (
        None
    )
    form: Annotated[
        Literal["packed", "folder"], Option("Write the .triasset as a single file (packed) or as a folder.")
    ] = "packed"


@command(
    "msb export data_stubs/checkpoint",
    "msb export data_stubs/checkpoint out/demo.triasset",
    "msb export --set opacity_floor=0.9999 data_stubs/checkpoint out/f.triasset",
    "msb export --json - --quiet data_stubs/checkpoint out/quiet.triasset",
)
def export(
    source: Annotated[
        Path, Argument("Output folder of a training, or the file of the model.", metavar="CHECKPOINT")
    ],
    target: Annotated[
        Path | None,
        Argument(
            "The .triasset to write. Default: the name of CHECKPOINT, in the current folder.",
            metavar="OUT",
            output="own",
            endings=(".triasset",),
        ),
    ] = None,
    *,
    options: ExportOptions,
    drawing: Annotated[RendererOptions, ("assignments",)],
    output: JsonOutput,
) -> None:
    """Convert a trained checkpoint to a .triasset. Neither PyTorch nor CUDA is needed.

    The method is detected from the content of the files. Settings come from the checkpoint, the training
    config, --set or defaults; the asset records the origin of each setting.
    """
    from msb.adapters.exporter import finish, read_model
    from msb.adapters.locate import locate
    from msb.api.command_files import note_opened
    from msb.asset import ASSET_SUFFIX, write_asset

    place = locate(source)
    target = target or Path(place.name + ASSET_SUFFIX)
    from msb.api.command_files import check_asset_place

    check_asset_place(target, options.form, output)
    with output.progress(f"reading {source.name}"):
        model = read_model(
            place,
            method=options.method,
            settings=drawing.assignments,
            config=options.config,
            reject="coordinates",
        )
    with output.bars() as progress:
        asset = finish(model, progress=progress)
        write_asset(asset, target, options.form, overwrite=output.force, progress=progress)
    note_opened(source, asset, output)
    warnings = [warning.to_dict() for warning in asset.warnings]
    head = {"schema": "msb.export/1", "path": str(target), "warnings": warnings}
    output.write_json({**head, "manifest": asset.manifest.to_dict()})
    if output.prints_text:
        _print(asset, target, output)


def _print(asset: Asset, target: Path, output: Output) -> None:
    from rich.markup import escape

    from msb.registry import lookup

    m = asset.manifest
    kind = () if m.primitive == "gaussian" else (m.topology.replace("_", " "),)
    files = [path for path in (target, *target.rglob("*")) if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    output.console().print(
        f"{escape(str(target))}: [bold]{lookup(m.method).title}[/bold], {', '.join((*kind, *m.counts))}, "
        f"SH degree {m.sh_degree}, {size:,} bytes",
        soft_wrap=True,
    )
    if output.quiet or not m.settings:
        return
    rows = ((name, setting_text(stored.value), stored.source) for name, stored in m.settings.items())
    output.table(("Setting", "Value", "From"), rows)
