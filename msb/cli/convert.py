"""`msb convert`: between .triasset (packed or folder) and the mesh formats every program reads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from msb.cli.options import WRITTEN, Force, Quiet, Verbose, epilog
from msb.cli.output import Output
from msb.errors import UsageError, about

EPILOG = epilog(
    "msb convert data_stubs/splat_like.triasset out/splat_like.glb --up=-y",
    "msb convert data_stubs/splat_like.triasset out/folder.triasset --form folder",
    "msb convert --official data_stubs/splat_like.triasset out/official.ply",
)
Up = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A .triasset, checkpoint or mesh file.")],
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
    from msb.asset import write_asset
    from msb.cli.inputs import open_asset

    with output.progress(f"reading {source.name}"):
        asset = open_asset(source, output)
    with output.progress(f"writing {target.name}"):
        write_asset(asset, target, form)


def _write_official(source: Path, target: Path, output: Output) -> None:
    from msb.adapters.official import write_official
    from msb.cli.inputs import open_asset

    with output.progress(f"reading {source.name}"):
        asset = open_asset(source, output)
    with output.progress(f"writing {target.name}"), about(source):
        write_official(asset, target)


def _write_mesh(source: Path, target: Path, up: Up | None, color: str, output: Output) -> None:
    from msb.atomic import new_file
    from msb.cli.inputs import open_asset
    from msb.meshes import read_mesh, write_mesh
    from msb.meshes.assets import mesh_from_asset, with_colors_for
    from msb.meshes.formats import FORMATS
    from msb.meshes.transform import turned_upright, with_linear_colors
    from msb.opening import is_mesh_file
    from msb.saving import output_suffix

    suffix = output_suffix(target, "OUT")
    with output.progress(f"reading {source.name}"):
        # The mesh itself: an asset would hold its coordinates in float32.
        mesh = read_mesh(source) if is_mesh_file(source) else mesh_from_asset(open_asset(source, output))
    fitting = with_colors_for(mesh, suffix)
    if fitting is not mesh:
        output.note(f"{target}: {suffix} has no face colours, so every face gets vertices of its own")
    if fitting.vertex_colors is not None and "vertex_colors" not in FORMATS[suffix].keeps:
        output.note(f"{target}: .stl has no colours; they are left out")
    fitting = turned_upright(fitting, up) if up else fitting
    fitting = with_linear_colors(fitting) if color == "linear" else fitting
    # What is wrong with coordinates and indices is wrong in the source.
    with output.progress(f"writing {target.name}"), about(source), new_file(target) as file:
        write_mesh(fitting, file, suffix=suffix)
