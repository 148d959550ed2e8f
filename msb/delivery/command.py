"""`msb convert`: converts between .triasset (packed or folder) and common mesh formats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.base.option import Argument, Option
from msb.cli.command import Typed, command
from msb.cli.output import Output, PlainOutput, echo
from msb.delivery import Engine
from msb.errors import EXIT_OK, MsbError, UsageError, about
from msb.render.options import Up

if TYPE_CHECKING:
    from msb.meshes import Mesh


@dataclass(frozen=True)
class ConvertOptions:
    """The options that affect the written files."""

    to: Annotated[
        str | None, Option("Format of the outputs if IN is a folder. Default: glb.", metavar="SUFFIX")
    ] = None
    form: Annotated[
        Literal["packed", "folder"] | None,
        Option("Write a .triasset as a single file or as a folder. Default: packed."),
    ] = None
    up: Annotated[
        Up | None,
        Option(
            "Axis that points up in IN. OUT is rotated so that +y points up. COLMAP scenes: -y. "
            "Default: no rotation; for .glb the up axis of IN, if it is known."
        ),
    ] = None
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
            "Write a .glb that this program opens correctly without import settings. web: the smallest file "
            "that keeps a PSNR of 50 dB, compressed, with WebP textures and reordered faces. All others: the "
            "same file as without this option.",
            ("--for",),
        ),
    ] = None
    official: Annotated[bool, Option("Write the file that the method's official exporter writes.")] = False


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
            "The output; its suffix selects the format. For an input folder: the output folder.",
            metavar="OUT",
            output="own",
        ),
    ],
    options: ConvertOptions,
    output: PlainOutput,
    typed: Typed,
) -> None:
    """Convert between .triasset and mesh files, keeping all vertices and faces, their order and colours.

    Mesh formats are .glb, .obj, .off, .ply, .stl, .usd, .usda, .usdc, .usdz and .gltf (read only). Notes list
    data that OUT cannot store, and data of IN that is ignored (normals, lights, bones).

    An asset is converted to its standard-tier mesh: opaque and unlit, with textures or static colours. With
    --official the file is the one that the method's official exporter writes. It may have alpha, duplicated
    faces or merged vertices.
    """
    if options.official:
        typed.reject(["form", "up", "color", "texture", "engine"], "cannot be combined with --official")
    if options.engine is not None:
        typed.reject(["color", "texture"], "cannot be combined with --for, which sets it")
    from msb.api.inputs import expand
    from msb.cli.output import report_error

    inputs = expand(source)
    output.add_inputs(inputs)
    if inputs == [source]:
        if "to" in typed:
            raise UsageError(
                "USAGE",
                f"--to needs an input folder; for a single file the suffix of {target.name} sets the format",
            )
        _check_target(target, options, output, typed)
        _convert(source, target, options, output)
        return
    outputs = _choose_outputs(source, inputs, target, options.to or "glb")
    for output_path in outputs.values():  # check all outputs before the first is written
        _check_target(output_path, options, output, typed)
    status = EXIT_OK
    for path, output_path in outputs.items():
        try:
            with about(path):
                _convert(path, output_path, options, output)
        except MsbError as error:
            status = max(status, report_error(error))
    if status:
        raise typer.Exit(status)


def _choose_outputs(source: Path, inputs: list[Path], target: Path, to: str) -> dict[Path, Path]:
    """Return input -> output; the outputs have the same layout in `target` as the inputs in `source`."""
    from msb.asset import is_asset
    from msb.delivery.saving import output_suffix

    suffix = output_suffix(Path(f"{inputs[0].stem}.{to.removeprefix('.')}"), "an output")
    if target.suffix and not target.is_dir():
        text = f"{source} has {len(inputs)} inputs, so OUT must be a folder; --to selects the format"
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
            raise UsageError("USAGE", f"{text}; convert one of them alone", file=path)
        taken[output_path] = path
    return outputs


def _check_target(target: Path, options: ConvertOptions, output: Output, typed: Typed) -> None:
    """Check the path of an output, and that its format stores the data that --color and --texture affect."""
    from msb.api.command_files import check_asset_place
    from msb.delivery.saving import output_suffix
    from msb.meshes.formats import FORMATS

    suffix = target.suffix.lower()
    keeps = FORMATS[suffix].keeps if suffix in FORMATS else ("textures",)
    if "texture" in typed and "textures" not in keeps:
        raise UsageError("USAGE", f"--texture needs a format that stores textures; {suffix} does not")
    if "color" in typed and not keeps:
        raise UsageError("USAGE", f"--color needs a format that stores colours; {suffix} does not")
    if not options.official:
        output_suffix(target, "OUT")
    check_asset_place(target, options.form, output)


def _convert(source: Path, target: Path, options: ConvertOptions, output: Output) -> None:
    """Convert one input; print the contents of the output, and notes on missing data."""
    from msb.asset import ASSET_SUFFIX

    if options.official:
        _write_official(source, target, output)
    elif target.suffix.lower() == ASSET_SUFFIX:
        if (options.up, options.color, options.texture, options.engine) != (None,) * 4:
            raise UsageError(
                "USAGE",
                "--up, --color, --texture and --for apply to mesh files; a .triasset is stored unchanged",
            )
        _write_asset(source, target, options.form or "packed", output)
    else:
        if options.form is not None:
            raise UsageError("USAGE", f"--form applies to .triasset only; {target.name} is a mesh file")
        _write_mesh(source, target, options, output)


def _write_asset(source: Path, target: Path, form: Literal["packed", "folder"], output: Output) -> None:
    from msb.api.command_files import open_asset
    from msb.asset import write_asset

    asset = open_asset(source, output)
    with output.progress(f"writing {target.name}"):
        write_asset(asset, target, form, overwrite=output.force)
    manifest = asset.manifest
    _print_summary(target, [f"{manifest.vertex_count:,} vertices", f"{manifest.face_count:,} faces"], output)


def _write_official(source: Path, target: Path, output: Output) -> None:
    from msb.adapters.official import write_official
    from msb.api.command_files import open_asset

    asset = open_asset(source, output)
    with output.progress(f"writing {target.name}"), about(source):
        write_official(asset, target)
    _print_summary(target, [f"written like the official exporter of {asset.manifest.method}"], output)


def _write_mesh(source: Path, target: Path, options: ConvertOptions, output: Output) -> None:
    from msb.adapters.locate import is_mesh_file
    from msb.api.command_files import open_asset, write_mesh_files
    from msb.delivery.saving import choose_style, output_suffix
    from msb.delivery.web_quality import ImageLoss
    from msb.meshes import read_mesh
    from msb.meshes.assets import fit_to_format, mesh_from_asset, without_bad_faces
    from msb.meshes.losses import (
        describe_up_axis,
        list_dropped_features,
        list_engine_losses,
        list_losses,
    )
    from msb.meshes.transform import rotate_upright

    suffix, asset = output_suffix(target, "OUT"), None
    if is_mesh_file(source):
        with output.progress(f"reading {source.name}"):
            mesh = read_mesh(source)  # an asset would round coordinates to float32
        ignored, known = list(mesh.left_out), True
        mesh, bad = without_bad_faces(mesh)
        if bad:
            output.note(f"{source}: {bad:,} faces have coordinates that are not finite; they are left out")
    else:
        asset = open_asset(source, output)
        mesh, ignored = mesh_from_asset(asset), list_dropped_features(asset)
        known = options.up is not None or asset.manifest.coordinate_frame.known_up is not None
    mesh = rotate_upright(mesh, options.up) if options.up else mesh
    with output.progress(f"choosing the encoding of {target.name}"), about(source):
        style, quality = choose_style(
            mesh, target, asset, color=options.color, texture=options.texture, engine=options.engine
        )
    # Errors in coordinates and indices name the source file.
    with output.progress(f"writing {target.name}"), about(source):
        storable = fit_to_format(mesh, suffix)
        write_mesh_files(storable, target, output, style)
    changes = [f"rotated upright (the up axis was {mesh.up})"] if mesh.up != storable.up else []
    if mesh.meters_per_unit not in (None, 1.0):
        changes.append(f"scaled to metres (a unit was {mesh.meters_per_unit:g} m)")
    quality_text = [quality] if quality else []
    _print_summary(target, [*_list_contents(storable, suffix), *changes, *quality_text], output)
    loss = ""
    if mesh.textures and not storable.textures and storable.vertex_colors is not None:
        loss = ImageLoss.of(mesh, asset).describe(replace(storable, vertices=mesh.vertices))
    engine_losses = list_engine_losses(storable, options.engine) if options.engine else ()
    for text in (
        *list_losses(mesh, storable, suffix, ignored, loss),
        *engine_losses,
        *describe_up_axis(mesh, suffix, known=known),
    ):
        output.note(f"{target}: {text}")


def _list_contents(mesh: Mesh, suffix: str) -> list[str]:
    """Return the numbers of vertices and faces, and the kinds of colours that the file stores."""
    from msb.meshes.formats import FORMATS

    form = FORMATS[suffix]
    counts = [f"{len(mesh.vertices):,} vertices", f"{len(mesh.faces):,} faces"]
    if mesh.textures and form.list_stored:
        return [*counts, *form.list_stored(mesh)]
    colors = [
        key.replace("_colors", " colours").replace("_uvs", " UVs")
        for key in form.keeps
        if key not in ("textures", "collision") and getattr(mesh, key) is not None
    ]
    if mesh.textures:
        colors.append(f"{len(mesh.textures)} texture{'' if len(mesh.textures) == 1 else 's'}")
    return [*counts, *(colors or ["no colours"])]


def _print_summary(target: Path, parts: list[str], output: Output) -> None:
    if not output.quiet:
        echo(f"{target}: {', '.join(parts)}")
