"""`msb web`: a page that shows a model in any browser, as engines draw it or as its method does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from msb.base.option import Argument, Option
from msb.cli.camera_options import NO_CAMERAS, Drawing, Up, Views
from msb.cli.command import Rule, command
from msb.cli.output import JsonOutput, Output, echo

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera

RULES = (
    Rule(
        "path out cameras renders faces quantise no_verify",
        "does not go with --verify, which reads a page and writes none",
        excludes="verify",
    ),
    Rule("at_least device", "needs --verify PAGE", needs="verify"),
    Rule("", "--out FILE is missing, or --verify PAGE", needs="out verify"),
    Rule("camera size renders", NO_CAMERAS, needs="cameras"),
    Rule("cameras assignments up", "needs an ASSET", needs="path verify"),
    Rule(
        "quantise faces renders json_file no_verify", "needs --tier dedicated", needs="tier=dedicated verify"
    ),
    Rule("tier", "dedicated needs an ASSET", needs="path tier=standard verify"),
)


@dataclass(frozen=True)
class WebOptions:
    """What the page shows, and what a page of the dedicated tier may lose."""

    out: Annotated[
        Path | None,
        Option(
            "The page to write: .html.",
            ("--out", "-o"),
            metavar="FILE",
            output="file",
            endings=(".html", ".htm"),
        ),
    ] = None
    tier: Annotated[
        Literal["standard", "dedicated"],
        Option("The mesh as engines draw it, or also the method's own look, by WebGPU."),
    ] = "standard"
    verify: Annotated[
        Path | None,
        Option("Measure a page of the dedicated tier again, in a browser.", metavar="PAGE"),
    ] = None
    up: Annotated[Up | None, Option("Axis that points up. Default: the asset's.")] = None
    quantise: Annotated[bool, Option("Round positions to 16 bits and the rest to 8: a third in size.")] = (
        False
    )
    faces: Annotated[
        int | None, Option("Keep the N faces that contribute most over the cameras.", least=1)
    ] = None
    renders: Annotated[
        Path | None,
        Option("Official images, by names of cameras, to measure the page by.", metavar="DIR"),
    ] = None
    no_verify: Annotated[bool, Option("Do not measure the page in a browser.")] = False
    at_least: Annotated[
        float | None, Option("With --verify: fail below so many dB. Default: 45.", metavar="DB")
    ] = None
    device: Annotated[
        Literal["cpu", "gpu"] | None,
        Option("With --verify: the browser's software (default), or a graphics card."),
    ] = None


class Shown(NamedTuple):
    """What a page shows."""

    name: str
    asset: Asset
    settings: dict[str, Any]
    cameras: list[Camera]
    up: str
    background: tuple[float, float, float]


@command(
    "msb web -o out/page.html data_stubs/splat_like.triasset",
    "msb web -o out/views.html --cameras data_stubs/views.json --up=-y \\\n      data_stubs/checkpoint",
    "msb web -o out/look.html --tier dedicated --quantise --no-verify \\\n"
    "      --cameras data_stubs/views.json --scale 0.25 data_stubs/checkpoint",
    "msb web -o out/empty.html",
    rules=RULES,
)
def web(
    path: Annotated[Path | None, Argument("A .triasset, checkpoint or mesh file.", metavar="ASSET")] = None,
    *,
    options: WebOptions,
    views: Views,
    drawing: Annotated[Drawing, ("assignments",)],
    output: JsonOutput,
) -> None:
    """Write a page that shows a model in any browser, offline.

    The page of the standard tier turns the mesh that any engine draws; without an ASSET it waits for a .glb
    to be dropped. That of the dedicated tier shows the method's own look by WebGPU, the mesh beside it, and
    says how many dB its pixels have to the reference renderer's.
    """

    if options.verify is not None:
        from msb.cli.web_dedicated import verify_page

        verify_page(options.verify, options, output)
        return
    target = options.out or Path()
    if path is None:
        from msb.engines.webpage import write_web_page

        write_web_page(target, background=views.color(None))
        _say(output, target)
        return
    from msb.asset.look import up_axis
    from msb.cli.inputs import open_asset
    from msb.views import choose_views

    with output.progress(f"reading {path.name}"):
        asset = open_asset(path, output)
    said = ""
    if views.cameras is not None:
        cameras = views.read(output)
    else:
        chosen = choose_views(asset)
        cameras, said = [] if chosen.origin == "turntable" else chosen.cameras, chosen.said
    axis = options.up or up_axis(asset)
    color = views.color(asset)
    shown = Shown(path.name, asset, drawing.settings(asset), cameras, axis, color)
    if options.up is None and asset.manifest.coordinate_frame.up == "unknown":
        output.note(f"{path}: what is up is not known and taken to be {axis}; --up says otherwise")
    if said:
        output.note(f"views: {said}")
    if options.tier == "standard":
        _write_mesh(shown, target, output)
    else:
        from msb.cli.web_dedicated import write_page

        write_page(shown, options, target, output)


def _write_mesh(shown: Shown, target: Path, output: Output) -> None:
    from msb.engines.engine import engine_mesh
    from msb.engines.webpage import LARGE, write_web_page
    from msb.render.backend import check_supported

    check_supported(shown.asset, "standard")
    mesh = engine_mesh(shown.asset, shown.settings)
    if len(mesh.indices) > LARGE:
        output.note(f"warning: {target}: {len(mesh.indices):,} faces are more than most browsers hold")
    with output.progress(f"writing {target.name}"):
        write_web_page(
            target,
            mesh.encoded(".glb"),
            name=shown.name,
            cameras=shown.cameras,
            up=shown.up,
            background=shown.background,
        )
    _say(output, target)


def _say(output: Output, target: Path) -> None:
    if not output.quiet:
        echo(str(target))
