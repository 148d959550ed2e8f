"""`msb web`: a page that shows a model in any browser, as engines draw it or as its method does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.cli.camera_options import Assignments, Background, Cameras, Chosen, Scale
from msb.cli.options import WRITTEN, Force, JsonFile, Quiet, Verbose, epilog, refuse
from msb.cli.output import Output, echo
from msb.cli.window import Up
from msb.errors import UsageError

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera

EPILOG = epilog(
    "msb web -o out/page.html data_stubs/splat_like.triasset",
    "msb web -o out/views.html --cameras data_stubs/views.json --up=-y \\\n      data_stubs/checkpoint",
    "msb web -o out/look.html --tier dedicated --quantise --no-verify \\\n"
    "      --cameras data_stubs/views.json --scale 0.25 data_stubs/checkpoint",
    "msb web -o out/empty.html",
)


def web(
    path: Annotated[
        Path | None, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")
    ] = None,
    *,
    target: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="The page to write: .html."), WRITTEN
    ] = None,
    tier: Annotated[
        Literal["standard", "dedicated"],
        typer.Option("--tier", help="The mesh as engines draw it, or also the method's own look, by WebGPU."),
    ] = "standard",
    verify: Annotated[
        Path | None,
        typer.Option(
            "--verify", metavar="PAGE", help="Measure a page of the dedicated tier again, in a browser."
        ),
    ] = None,
    cameras: Cameras = None,
    chosen: Chosen = None,
    scale: Scale = None,
    background: Background = None,
    assignments: Assignments = None,
    up: Up = None,
    quantise: Annotated[
        bool,
        typer.Option("--quantise", help="Round positions to 16 bits and the rest to 8: a third in size."),
    ] = False,
    faces: Annotated[
        int | None,
        typer.Option(
            "--faces", min=1, metavar="N", help="Keep the N faces that contribute most over the cameras."
        ),
    ] = None,
    renders: Annotated[
        Path | None,
        typer.Option(
            "--renders", metavar="DIR", help="Official images, by names of cameras, to measure the page by."
        ),
    ] = None,
    no_verify: Annotated[
        bool, typer.Option("--no-verify", help="Do not measure the page in a browser.")
    ] = False,
    at_least: Annotated[
        float | None,
        typer.Option("--at-least", metavar="DB", help="With --verify: fail below so many dB. Default: 45."),
    ] = None,
    device: Annotated[
        Literal["cpu", "gpu"] | None,
        typer.Option("--device", help="With --verify: the browser's software (default), or a graphics card."),
    ] = None,
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Write a page that shows a model in any browser, offline.

    The page of the standard tier turns the mesh that any engine draws; without an ASSET it waits for a .glb
    to be dropped. That of the dedicated tier shows the method's own look by WebGPU, the mesh beside it, and
    says how many dB its pixels have to the reference renderer's.
    """
    output = Output(json_file, quiet, verbose, force)
    if verify is not None:
        from msb.cli.web_dedicated import verify_page

        given = {"ASSET": path, "out": target, "cameras": cameras, "renders": renders, "faces": faces}
        _refuse_with_verify({**given, "quantise": quantise or None, "no-verify": no_verify or None})
        output.check_outputs()
        verify_page(verify, output, at_least, device=device)
        return
    refuse({"at-least": at_least, "device": device}, "needs --verify PAGE")
    if target is None:
        raise UsageError("USAGE", "--out FILE is missing, or --verify PAGE")
    from msb.api.saving import checked_ending

    checked_ending(target, "--out", (".html", ".htm"))
    if cameras is None:
        refuse({"camera": chosen, "scale": scale, "renders": renders}, "needs --cameras PATH")
    if path is None:
        refuse({"cameras": cameras, "set": assignments, "up": up}, "needs an ASSET")
    if tier == "standard":
        special = {"quantise": quantise or None, "faces": faces, "renders": renders, "json": json_file}
        refuse({**special, "no-verify": no_verify or None}, "needs --tier dedicated")
    elif path is None:
        raise UsageError("USAGE", "--tier dedicated needs an ASSET")
    output.check_free(target)
    output.check_outputs()
    if path is None:
        from msb.cli.camera_options import parse_background
        from msb.engines.webpage import write_web_page

        write_web_page(target, background=parse_background(background, None))
        _say(output, target)
        return
    from msb.asset.look import up_axis
    from msb.asset.settings import parse_overrides
    from msb.cli.camera_options import cameras_at, parse_background
    from msb.cli.inputs import open_asset
    from msb.views import choose_views

    with output.progress(f"reading {path.name}"):
        asset = open_asset(path, output)
    settings = parse_overrides(asset.manifest.method, assignments or [])
    said = ""
    if cameras is not None:
        views = cameras_at(cameras, chosen, None, scale, output)
    else:
        found = choose_views(asset)
        views, said = [] if found.origin == "turntable" else found.cameras, found.said
    color, axis = parse_background(background, asset), up or up_axis(asset)
    if up is None and asset.manifest.coordinate_frame.up == "unknown":
        output.note(f"{path}: what is up is not known and taken to be {axis}; --up says otherwise")
    if said:
        output.note(f"views: {said}")
    if tier == "standard":
        _write_mesh(asset, target, output, path.name, settings, views, axis, color)
        return
    from msb.cli.web_dedicated import write_page

    write_page(
        asset,
        target,
        output,
        name=path.name,
        settings=settings,
        cameras=views,
        renders=renders,
        up=axis,
        background=color,
        quantise=quantise,
        faces=faces,
        verify=not no_verify,
    )


def _refuse_with_verify(given: dict[str, object]) -> None:
    for name, value in given.items():
        if value is not None:
            shown = name if name.isupper() else f"--{name}"
            raise UsageError(
                "USAGE", f"{shown} does not go with --verify, which reads a page and writes none"
            )


def _write_mesh(
    asset: Asset,
    target: Path,
    output: Output,
    name: str,
    settings: dict[str, Any],
    views: list[Camera],
    up: str,
    background: tuple[float, float, float],
) -> None:
    from msb.engines.mesh import engine_mesh
    from msb.engines.webpage import LARGE, write_web_page

    mesh = engine_mesh(asset, settings)
    if len(mesh.indices) > LARGE:
        output.note(f"warning: {target}: {len(mesh.indices):,} faces are more than most browsers hold")
    with output.progress(f"writing {target.name}"):
        write_web_page(
            target,
            mesh.encoded(".glb"),
            name=name,
            cameras=views,
            up=up,
            background=background,
        )
    _say(output, target)


def _say(output: Output, target: Path) -> None:
    if not output.quiet:
        echo(str(target))
