"""`msb convert` converts between .triasset (packed or folder) and common mesh formats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.asset.frame import make_frame
from msb.base.option import Argument, Option
from msb.cli.command import Typed, command
from msb.cli.output import Output, PlainOutput, echo
from msb.delivery import Engine
from msb.errors import EXIT_OK, MsbError, UsageError, about
from msb.render.options import Floor, KnownDistance, Scale, UpDirection

if TYPE_CHECKING:
    from msb.delivery.converting import Conversion


@dataclass(frozen=True)
class ConvertOptions:
    """The options that affect the contents of written files."""

    to: Annotated[
        str | None, Option("Format of the outputs, if IN is a folder. Default: glb.", metavar="SUFFIX")
    ] = None
    form: Annotated[
        Literal["packed", "folder"] | None,
        Option("Write a .triasset as a single file or as a folder. Default: packed."),
    ] = None
    up: Annotated[
        UpDirection | None,
        Option(
            "Axis or direction that points up in IN. In a mesh file, this direction is rotated to +y. "
            "In COLMAP scenes this direction is about -y. Default: no rotation; for .glb and USD the up axis "
            "of IN, if known.",
            metavar="AXIS|X,Y,Z",
        ),
    ] = None
    scale: Scale = None
    known_distance: KnownDistance = None
    floor: Floor = False
    color: Annotated[
        Literal["linear", "srgb"] | None,
        Option("Colour space of vertex colours. Default: linear in .glb, as glTF specifies, else srgb."),
    ] = None
    texture: Annotated[
        Literal["png", "jpeg", "webp"] | None,
        Option("Image format of textures. Default: png, which is lossless. Some programs cannot read webp."),
    ] = None
    engine: Annotated[
        Engine | None,
        Option(
            "Write a .glb that this program opens correctly without import settings. web: the smallest "
            "compressed file that keeps a PSNR of 50 dB, with WebP textures and reordered faces. All "
            "other programs: the same file as without this option.",
            ("--for",),
        ),
    ] = None
    official: Annotated[bool, Option("Write the same file as the method's official exporter.")] = False


@command(
    "msb convert data_stubs/checkpoint out/upright.glb",
    "msb convert --for web data_stubs/models/pebble/mesh_splatting out/web.glb",
    "msb convert data_stubs/splat_like.triasset out/folder.triasset --form folder",
    "msb convert --official data_stubs/splat_like.triasset out/official.ply",
    "msb convert --to triasset data_stubs/models/pebble out/assets",
)
def convert(
    source: Annotated[
        Path,
        Argument("A .triasset, checkpoint or mesh file, or a folder of these.", metavar="IN"),
    ],
    target: Annotated[
        Path,
        Argument(
            "The output file; its suffix selects the format. For an input folder: the output folder.",
            metavar="OUT",
            output="own",
        ),
    ],
    options: ConvertOptions,
    output: PlainOutput,
    typed: Typed,
) -> None:
    """Convert between .triasset and mesh files. All vertices and faces, their order and their colours are
    kept.

    Mesh formats are .glb, .obj, .off, .ply, .stl, .usd, .usda, .usdc, .usdz and .gltf (read only). Notes list
    the data that OUT cannot store, and the ignored data of IN (normals, lights, bones).

    An asset is converted to its standard-tier mesh: opaque and unlit, with textures or static colours. With
    --official, the method's official exporter writes the file. Files of an official exporter may have alpha,
    duplicated faces or merged vertices.
    """
    if options.official:
        names = ["form", "up", "scale", "known_distance", "floor", "color", "texture", "engine"]
        typed.reject(names, "cannot be combined with --official")
    if options.engine is not None:
        typed.reject(["color", "texture"], "cannot be combined with --for, which sets this option")
    from msb.api.command_files import check_asset_place
    from msb.api.inputs import expand
    from msb.cli.output import report_error
    from msb.delivery.converting import Conversion

    conversion = Conversion(
        options.form,
        make_frame(options.up, options.scale, options.known_distance),
        options.color,
        options.texture,
        options.engine,
        floor=options.floor,
        official=options.official,
        overwrite=output.force,
        stage=output.progress,
        check_free=output.check_free,
        note=output.note,
    )
    inputs = expand(source)
    output.add_inputs(inputs)
    if inputs == [source]:
        if "to" in typed:
            raise UsageError(
                "USAGE",
                f"--to applies only to an input folder; for a single file the suffix of {target.name} "
                "sets the format",
            )
        conversion.check_target(target)
        check_asset_place(target, options.form, output)
        _convert(conversion, source, target, output)
        return
    outputs = _choose_outputs(source, inputs, target, options.to or "glb")
    for output_path in outputs.values():  # check all output paths before the first file is written
        conversion.check_target(output_path)
        check_asset_place(output_path, options.form, output)
    status = EXIT_OK
    for path, output_path in outputs.items():
        try:
            with about(path):
                _convert(conversion, path, output_path, output)
        except MsbError as error:
            status = max(status, report_error(error))
    if status:
        raise typer.Exit(status)


def _choose_outputs(source: Path, inputs: list[Path], target: Path, to: str) -> dict[Path, Path]:
    """Return the output path for each input path.

    The outputs in `target` have the folder layout of the inputs in `source`.
    """
    from msb.asset import is_asset
    from msb.delivery.saving import output_suffix

    suffix = output_suffix(Path(f"{inputs[0].stem}.{to.removeprefix('.')}"), "an output")
    if target.suffix and not target.is_dir():
        text = f"{source} has {len(inputs)} inputs, so OUT must be a folder; pass --to for the format"
        raise UsageError("USAGE", text, file=target)
    root = source if source.is_dir() else None
    outputs = {}
    for path in inputs:
        below = path.relative_to(root) if root else Path(path.name)
        name = below.stem if path.is_file() or is_asset(path) else below.name
        outputs[path] = target / below.with_name(name + suffix)
    taken: dict[Path, Path] = {}
    for path, output_path in outputs.items():
        if output_path in taken:
            text = f"{taken[output_path]} and this file would both be written to {output_path}"
            raise UsageError("USAGE", f"{text}; convert these files separately", file=path)
        taken[output_path] = path
    return outputs


def _convert(conversion: Conversion, source: Path, target: Path, output: Output) -> None:
    """Convert one input. Then print the contents of the output, and notes about missing data."""
    done = conversion.run(source, target)
    if not output.quiet:
        echo(f"{target}: {', '.join(done.contents)}")
    for text in done.notes:
        output.note(text)
