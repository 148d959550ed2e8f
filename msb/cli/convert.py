"""`msb convert`: between .triasset (packed or folder) and the mesh formats every program reads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from msb.cli.failures import about
from msb.cli.options import WRITTEN, Force, Quiet, Verbose, epilog
from msb.cli.output import Output
from msb.errors import UsageError

EPILOG = epilog(
    "msb convert data_stubs/splat_like.triasset out/splat_like.glb --up=-y",
    "msb convert data_stubs/splat_like.triasset out/folder.triasset --form folder",
    "msb convert --official data_stubs/splat_like.triasset out/official.ply",
)
Up = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A .triasset or a mesh file.")],
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Its suffix says what is written."),
        WRITTEN,
    ],
    form: Annotated[
        Literal["packed", "folder"] | None, typer.Option(help="Form of a .triasset; packed if not given.")
    ] = None,
    up: Annotated[
        Up | None,
        typer.Option(help="Axis that points up in IN; OUT is turned so that it is +y. COLMAP scenes: -y."),
    ] = None,
    color: Annotated[
        Literal["stored", "linear"], typer.Option(help="Colours as stored, or sRGB converted to linear.")
    ] = "stored",
    official: Annotated[
        bool, typer.Option("--official", help="Write what the method's own exporter would write.")
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Convert between .triasset and mesh files, keeping rows, order and vertex colours.

    Mesh files are {mesh_suffixes}.

    An asset becomes its standard-tier mesh: opaque, unlit, with static colours. With --official it becomes
    what the method's own exporter makes of it, which may differ: alpha, doubled faces, merged vertices.
    """
    from msb.asset import ASSET_SUFFIX

    output = Output(None, quiet, verbose, force)
    output.check_free(target, folder=form == "folder")
    if official:
        if form is not None or up is not None or color != "stored":
            raise UsageError("USAGE", "--official goes without --form, --up and --color")
        _write_official(source, target, output)
    elif target.suffix.lower() == ASSET_SUFFIX:
        if up is not None or color != "stored":
            raise UsageError("USAGE", "--up and --color are for mesh files; a .triasset keeps what is stored")
        _write_asset(source, target, form or "packed", output)
    else:
        if form is not None:
            raise UsageError("USAGE", f"--form is for .triasset; {target.name} is a mesh file")
        _write_mesh(source, target, up, color, output)


def _write_asset(source: Path, target: Path, form: Literal["packed", "folder"], output: Output) -> None:
    from msb.asset import is_asset, load, save
    from msb.cli.inputs import note_warnings

    with output.progress(f"reading {source.name}"):
        if is_asset(source):
            asset = load(source)
        else:
            from msb.adapters import export

            asset = export(source, method="mesh")
    note_warnings(asset.warnings, source, output)
    with output.progress(f"writing {target.name}"):
        save(asset, target, form)


def _write_official(source: Path, target: Path, output: Output) -> None:
    from msb.adapters.official import official_exporter, write_official
    from msb.asset import is_asset, load

    if not is_asset(source):
        official_exporter("mesh")  # which says that there is none
    with output.progress(f"reading {source.name}"):
        asset = load(source)
    with output.progress(f"writing {target.name}"), about(source):
        write_official(asset, target)


def _write_mesh(source: Path, target: Path, up: Up | None, color: str, output: Output) -> None:
    from msb.asset import ASSET_SUFFIX, is_asset
    from msb.atomic import new_file
    from msb.cli.inputs import note_warnings
    from msb.meshes import read_mesh, write_mesh
    from msb.meshes.assets import mesh_from_asset, with_vertex_colors
    from msb.meshes.formats import FORMATS, written_suffixes
    from msb.meshes.transform import turned_upright, with_linear_colors

    suffix = target.suffix.lower()
    if suffix not in written_suffixes():
        wanted = ", ".join((ASSET_SUFFIX, *written_suffixes()))
        raise UsageError("USAGE", f'OUT is "{target.name}"; it must end in one of {wanted}')
    with output.progress(f"reading {source.name}"):
        if is_asset(source):
            from msb.asset import load

            asset = load(source)
            note_warnings(asset.warnings, source, output)
            mesh = mesh_from_asset(asset)
        else:
            mesh = read_mesh(source)
    keeps = FORMATS[suffix].keeps
    if mesh.face_colors is not None and mesh.vertex_colors is None and "face_colors" not in keeps:
        mesh = with_vertex_colors(mesh)
        output.note(f"{target}: {suffix} has no face colours, so every face gets vertices of its own")
    if mesh.vertex_colors is not None and "vertex_colors" not in keeps:
        output.note(f"{target}: {suffix} has no colours; they are left out")
    mesh = turned_upright(mesh, up) if up else mesh
    mesh = with_linear_colors(mesh) if color == "linear" else mesh
    # What is wrong with coordinates and indices is wrong in the source.
    with output.progress(f"writing {target.name}"), about(source), new_file(target) as file:
        write_mesh(mesh, file, suffix=suffix)
