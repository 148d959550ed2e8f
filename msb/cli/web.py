"""`msb web`: a page of three.js that shows the mesh any engine draws, and needs nothing but a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from msb.cli.camera_options import Assignments, Background, Cameras, Chosen, Scale
from msb.cli.options import WRITTEN, Force, Quiet, Verbose, epilog, refuse
from msb.cli.output import Output, echo
from msb.cli.window import Up
from msb.errors import UsageError

EPILOG = epilog(
    "msb web -o out/page.html data_stubs/splat_like.triasset",
    "msb web -o out/views.html --cameras data_stubs/views.json --up=-y \\\n      data_stubs/checkpoint",
    "msb web -o out/empty.html",
)


def web(
    path: Annotated[
        Path | None, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")
    ] = None,
    *,
    target: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="The page to write: .html."), WRITTEN
    ],
    cameras: Cameras = None,
    chosen: Chosen = None,
    scale: Scale = None,
    background: Background = "white",
    assignments: Assignments = None,
    up: Up = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Write a page that shows a mesh as engines draw it, in any browser, offline.

    The page turns the mesh of the standard tier and has the cameras in a list. Without an ASSET it waits for
    a .glb to be dropped.
    """
    from msb.cli.camera_options import parse_background
    from msb.engines.webpage import write_web_page

    output = Output(None, quiet, verbose, force)
    if target.suffix.lower() not in (".html", ".htm"):
        raise UsageError("USAGE", f'--out: "{target.name}" must end in .html, .htm')
    if cameras is None:
        refuse({"camera": chosen, "scale": scale}, "needs --cameras PATH")
    if path is None:
        refuse({"cameras": cameras, "set": assignments, "up": up}, "needs an ASSET")
    output.check_free(target)
    if path is None:
        write_web_page(target, background=parse_background(background, None))
    else:
        from msb.asset.settings import parse_overrides
        from msb.cli.camera_options import choose_cameras
        from msb.cli.inputs import open_asset
        from msb.engines.mesh import engine_mesh
        from msb.engines.webpage import LARGE
        from msb.scenes import read_cameras

        with output.progress(f"reading {path.name}"):
            asset = open_asset(path, output)
        settings = parse_overrides(asset.manifest.method, assignments or [])
        mesh = engine_mesh(asset, settings)
        views = choose_cameras(read_cameras(cameras), chosen, None, scale) if cameras is not None else []
        if len(mesh.indices) > LARGE:
            output.note(f"{target}: {len(mesh.indices):,} faces are more than most browsers hold")
        axis = up or asset.manifest.coordinate_frame.up
        with output.progress(f"writing {target.name}"):
            write_web_page(
                target,
                mesh.encoded(".glb"),
                name=path.name,
                cameras=views,
                up=axis if axis != "unknown" else "-y",  # as COLMAP scenes are
                background=parse_background(background, asset),
            )
    if not output.quiet:
        echo(str(target))
