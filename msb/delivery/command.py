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
    """How each input is written."""

    to: Annotated[
        str | None, Option("For an input folder: the format to write. Default: glb.", metavar="SUFFIX")
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
            "Write a .glb for this program that needs no import settings. web: compressed, with WebP "
            "textures and reordered faces, in the smallest encoding that keeps a PSNR of 50 dB. All others: "
            "as without this option.",
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
    --official the method's official exporter writes the file, which may have alpha, duplicated faces or
    merged vertices.
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
                "USAGE", f"--to needs an input folder; for one file the suffix of {target.name} is used"
            )
        _check_target(target, options, output, typed)
        _convert(source, target, options, output)
        return
    places = _places(source, inputs, target, options.to or "glb")
    for place in places.values():  # check all outputs before the first is written
        _check_target(place, options, output, typed)
    status = EXIT_OK
    for path, place in places.items():
        try:
            with about(path):
                _convert(path, place, options, output)
        except MsbError as error:
            status = max(status, report_error(error))
    if status:
        raise typer.Exit(status)


def _places(source: Path, inputs: list[Path], target: Path, to: str) -> dict[Path, Path]:
    """Return input -> output; the outputs have the same layout in `target` as the inputs in `source`."""
    from msb.asset import is_asset
    from msb.delivery.saving import output_suffix

    suffix = output_suffix(Path(f"{inputs[0].stem}.{to.removeprefix('.')}"), "an output")
    if target.suffix and not target.is_dir():
        text = f"{source} has {len(inputs)} inputs, so OUT must be a folder; --to selects the format"
        raise UsageError("USAGE", text, file=target)
    root = source if source.is_dir() else None
    places = {}
    for path in inputs:
        below = path.relative_to(root) if root else Path(path.name)
        name = below.stem if path.is_file() or is_asset(path) else below.name
        places[path] = target / below.with_name(name + suffix)
    taken: dict[Path, Path] = {}
    for path, place in places.items():
        if place in taken:
            text = f"{taken[place]} and this file would both be written to {place}; convert one of them alone"
            raise UsageError("USAGE", text, file=path)
        taken[place] = path
    return places


def _check_target(target: Path, options: ConvertOptions, output: Output, typed: Typed) -> None:
    """Check the path of an output, and that its format can store the data that the options affect."""
    from msb.api.command_files import check_asset_place
    from msb.delivery.saving import output_suffix
    from msb.meshes.formats import FORMATS

    suffix = target.suffix.lower()
    keeps = FORMATS[suffix].keeps if suffix in FORMATS else ("textures",)
    if "texture" in typed and "textures" not in keeps:
        raise UsageError("USAGE", f"--texture needs a format with textures; {suffix} has none")
    if "color" in typed and not keeps:
        raise UsageError("USAGE", f"--color needs a format with colours; {suffix} has none")
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
    _say(target, [f"{manifest.vertex_count:,} vertices", f"{manifest.face_count:,} faces"], output)


def _write_official(source: Path, target: Path, output: Output) -> None:
    from msb.adapters.official import write_official
    from msb.api.command_files import open_asset

    asset = open_asset(source, output)
    with output.progress(f"writing {target.name}"), about(source):
        write_official(asset, target)
    _say(target, [f"written like the official exporter of {asset.manifest.method}"], output)


def _write_mesh(source: Path, target: Path, options: ConvertOptions, output: Output) -> None:
    from msb.adapters.locate import is_mesh_file
    from msb.api.command_files import open_asset, write_mesh_files
    from msb.delivery.saving import output_suffix, style_for
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
            mesh = read_mesh(source)  # not as an asset, which would round coordinates to float32
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
        style, quality = style_for(
            mesh, target, asset, color=options.color, texture=options.texture, engine=options.engine
        )
    # Errors of coordinates and indices are reported for the source.
    with output.progress(f"writing {target.name}"), about(source):
        storable = fit_to_format(mesh, suffix)
        write_mesh_files(storable, target, output, style)
    rotated = [f"rotated upright ({mesh.up} was up)"] if mesh.up != storable.up else []
    _say(target, [*_list_contents(storable, suffix), *rotated, *([quality] if quality else [])], output)
    loss = ""
    if mesh.textures and not storable.textures and storable.vertex_colors is not None:
        loss = ImageLoss.of(mesh, asset).describe(replace(storable, vertices=mesh.vertices))
    behind = list_engine_losses(storable, options.engine) if options.engine else ()
    for text in (
        *list_losses(mesh, storable, suffix, ignored, loss),
        *behind,
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


def _say(target: Path, parts: list[str], output: Output) -> None:
    if not output.quiet:
        echo(f"{target}: {', '.join(parts)}")
