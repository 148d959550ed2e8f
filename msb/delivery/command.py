"""`msb convert`: between .triasset (packed or folder) and the mesh formats every program reads."""

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
    """What is written of each input."""

    to: Annotated[str | None, Option("Of a folder: what is written. Default: glb.", metavar="SUFFIX")] = None
    form: Annotated[
        Literal["packed", "folder"] | None, Option("Form of a .triasset; packed if not given.")
    ] = None
    up: Annotated[
        Up | None,
        Option(
            "Axis that points up in IN; OUT is turned so that it is +y. COLMAP scenes: -y. "
            "Default: as stored; for .glb what IN is known to have."
        ),
    ] = None
    color: Annotated[
        Literal["linear", "srgb"] | None,
        Option("Colours of vertices. Default: linear in .glb, as glTF says, else srgb."),
    ] = None
    texture: Annotated[
        Literal["png", "jpeg", "webp"] | None,
        Option("Image files of textures. Default: png, which loses nothing; WebP is not opened everywhere."),
    ] = None
    engine: Annotated[
        Engine | None,
        Option(
            "Write the .glb that it opens with no setting touched. For the web: compressed, with WebP, rows "
            "in another order, as coarse as 50 dB allow; for all others what is written without this.",
            ("--for",),
        ),
    ] = None
    official: Annotated[bool, Option("Write what the method's own exporter would write.")] = False


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
            "Its suffix says what is written. Of a folder: the folder to write into.",
            metavar="OUT",
            output="own",
        ),
    ],
    options: ConvertOptions,
    output: PlainOutput,
    typed: Typed,
) -> None:
    """Convert between .triasset and mesh files, keeping rows, order and vertex colours.

    Mesh files are .glb, .obj, .off, .ply, .stl, .usd, .usda, .usdc, .usdz and .gltf (read only). Notes name
    what OUT cannot hold, and what was not read of IN (normals, lights, bones).

    An asset becomes its standard-tier mesh: opaque, unlit, with its textures or static colours. With
    --official it becomes what the method's own exporter makes of it, which may differ: alpha, doubled faces,
    merged vertices.
    """
    if options.official:
        typed.reject(["form", "up", "color", "texture", "engine"], "does not go with --official")
    if options.engine is not None:
        typed.reject(["color", "texture"], "does not go with --for, which knows it")
    from msb.api.inputs import expand
    from msb.cli.output import report_error

    inputs = expand(source)
    output.add_inputs(inputs)
    if inputs == [source]:
        if "to" in typed:
            raise UsageError("USAGE", f"--to is for a folder; {target.name} says itself what it is")
        _check_target(target, options, output, typed)
        _convert(source, target, options, output)
        return
    places = _places(source, inputs, target, options.to or "glb")
    for place in places.values():  # before the first is written, which can be the input of a later one
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
    """Return input -> output, which lies below `target` as the input lies below the folder `source`."""
    from msb.asset import is_asset
    from msb.delivery.saving import output_suffix

    suffix = output_suffix(Path(f"{inputs[0].stem}.{to.removeprefix('.')}"), "an output")
    if target.suffix and not target.is_dir():
        text = f"{source} holds {len(inputs)} inputs; OUT must be a folder, and --to says what is written"
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
            text = f"{taken[place]} and this would both become {place}; convert one of them by itself"
            raise UsageError("USAGE", text, file=path)
        taken[place] = path
    return places


def _check_target(target: Path, options: ConvertOptions, output: Output, typed: Typed) -> None:
    """Check the path of an output, and that its format holds what the options are about."""
    from msb.api.command_files import check_asset_place
    from msb.delivery.saving import output_suffix
    from msb.meshes.formats import FORMATS

    suffix = target.suffix.lower()
    keeps = FORMATS[suffix].keeps if suffix in FORMATS else ("textures",)
    if "texture" in typed and "textures" not in keeps:
        raise UsageError("USAGE", f"--texture is for formats with textures; {suffix} holds none")
    if "color" in typed and not keeps:
        raise UsageError("USAGE", f"--color is for formats with colours; {suffix} holds none")
    if not options.official:
        output_suffix(target, "OUT")
    check_asset_place(target, options.form, output)


def _convert(source: Path, target: Path, options: ConvertOptions, output: Output) -> None:
    """Convert one input, and say what was written and what was left out."""
    from msb.asset import ASSET_SUFFIX

    if options.official:
        _write_official(source, target, output)
    elif target.suffix.lower() == ASSET_SUFFIX:
        if (options.up, options.color, options.texture, options.engine) != (None,) * 4:
            raise UsageError(
                "USAGE",
                "--up, --color, --texture and --for are for mesh files; a .triasset keeps what is stored",
            )
        _write_asset(source, target, options.form or "packed", output)
    else:
        if options.form is not None:
            raise UsageError("USAGE", f"--form is for .triasset; {target.name} is a mesh file")
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
    _say(target, [f"as the exporter of {asset.manifest.method} writes it"], output)


def _write_mesh(source: Path, target: Path, options: ConvertOptions, output: Output) -> None:
    from msb.adapters.locate import is_mesh_file
    from msb.api.command_files import open_asset, write_mesh_files
    from msb.delivery.pictures import Pictures
    from msb.delivery.saving import output_suffix, style_for
    from msb.meshes import read_mesh
    from msb.meshes.assets import as_held, mesh_from_asset
    from msb.meshes.losses import beyond_a_mesh, left_behind, losses, what_is_up
    from msb.meshes.transform import turned_upright

    suffix, asset = output_suffix(target, "OUT"), None
    if is_mesh_file(source):
        with output.progress(f"reading {source.name}"):
            mesh = read_mesh(source)  # itself: an asset would hold its coordinates in float32
        left_out, known = list(mesh.left_out), True
    else:
        asset = open_asset(source, output)
        mesh, left_out = mesh_from_asset(asset), beyond_a_mesh(asset)
        known = options.up is not None or asset.manifest.coordinate_frame.known_up is not None
    mesh = turned_upright(mesh, options.up) if options.up else mesh
    with output.progress(f"trying how much {target.name} may lose"), about(source):
        style, kept = style_for(
            mesh, target, asset, color=options.color, texture=options.texture, engine=options.engine
        )
    # What is wrong with coordinates and indices is wrong in the source.
    with output.progress(f"writing {target.name}"), about(source):
        held = as_held(mesh, suffix)
        write_mesh_files(held, target, output, style)
    turned = [f"turned upright ({mesh.up} was up)"] if mesh.up != held.up else []
    _say(target, [*_holds(held, suffix), *turned, *([kept] if kept else [])], output)
    if mesh.textures and not held.textures and held.vertex_colors is not None:
        lost = Pictures.of(mesh, asset).lost(replace(held, vertices=mesh.vertices))
        output.note(f"{target}: {suffix} holds no textures, which are colours of vertices there{lost}")
    behind = left_behind(held, options.engine) if options.engine else ()
    for text in (*losses(mesh, held, suffix, left_out), *behind, *what_is_up(mesh, suffix, known=known)):
        output.note(f"{target}: {text}")


def _holds(mesh: Mesh, suffix: str) -> list[str]:
    """Return what the file has."""
    from msb.meshes.formats import FORMATS

    keeps = FORMATS[suffix].keeps
    colors = [
        key.replace("_colors", " colours").replace("_uvs", " UVs")
        for key in keeps
        if key not in ("textures", "collision") and getattr(mesh, key) is not None
    ]
    if mesh.textures:
        colors.append(f"{len(mesh.textures)} texture{'' if len(mesh.textures) == 1 else 's'}")
    return [f"{len(mesh.vertices):,} vertices", f"{len(mesh.faces):,} faces", *(colors or ["no colours"])]


def _say(target: Path, parts: list[str], output: Output) -> None:
    if not output.quiet:
        echo(f"{target}: {', '.join(parts)}")
