"""`msb compare`: what deployment makes of a model's look, tier beside tier, on a window or in a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.cli.camera_options import Assignments, Background, Cameras, Chosen, Scale, Supersample
from msb.cli.options import DeviceName, Force, Quiet, Verbose, epilog, refuse
from msb.cli.output import Output, echo
from msb.cli.window import (
    DEFAULT_SIZE,
    Files,
    Html,
    Screenshot,
    Up,
    UpAxis,
    WindowSize,
    open_probe,
    parse_window_size,
)
from msb.errors import about

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera
    from msb_viewers.deployment.shots import Comparison
    from msb_viewers.deployment.state import CompareState
    from msb_viewers.deployment.views import View

EPILOG = epilog(
    "msb compare --cameras data_stubs/views.json data_stubs/checkpoint",
    "msb compare --layout wipe --screenshot out/w.png data_stubs/checkpoint",
    "msb compare --tiers dedicated,standard --html out/c.html \\\n"
    "      --cameras data_stubs/views.json --scale 0.25 data_stubs/checkpoint",
)
Layout = Literal["side", "wipe", "difference"]
TURNTABLE = (8, 640, 480)
"""The number of views on a page without cameras, and their width and height in pixels."""


@dataclass(frozen=True)
class CompareOptions:
    """What to compare, as the command line has it."""

    cameras: str | None = None
    chosen: list[str] | None = None
    images: Path | None = None
    scale: float | None = None
    layout: Layout = "side"
    tiers: list[str] | None = None
    pair: str | None = None
    background: str | None = None
    assignments: list[str] | None = None
    supersample: int = 1
    device: str | None = None
    up: UpAxis | None = None
    size: tuple[int, int] = (1280, 800)


def compare(
    path: Annotated[Path, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")],
    screenshot: Screenshot = None,
    html: Html = None,
    cameras: Cameras = None,
    chosen: Chosen = None,
    images: Annotated[
        Path | None,
        typer.Option(
            "--image-folder",
            "--images",
            metavar="NAME|FOLDER",
            help="The photographs' folder in the scene, e.g. images_2, or any other. Default: where the "
            "dataset says, or else the largest that are there.",
        ),
    ] = None,
    scale: Scale = None,
    layout: Annotated[Layout, typer.Option(help="How pictures are shown at first.")] = "side",
    tiers: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TIERS",
            help="Some of reference, dedicated, standard and truth (photographs). Default: all.",
        ),
    ] = None,
    pair: Annotated[
        str | None, typer.Option(metavar="A,B", help="Tiers that wipe and difference show at first.")
    ] = None,
    background: Background = None,
    assignments: Assignments = None,
    supersample: Supersample = 1,
    device: DeviceName = None,
    up: Up = None,
    size: WindowSize = DEFAULT_SIZE,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """See what deployment makes of a model's look: its tiers and the dataset's photographs.

    Pictures stand side by side, with a wipe, or as a map of their difference with its PSNR. The command opens
    a window; with --screenshot or --html it writes these instead and needs no display. Without --cameras
    the views are those of its training where they lie beside it, else from around.
    """
    output = Output(None, quiet, verbose, force)
    files = Files(screenshot, None, html)
    options = CompareOptions(
        cameras,
        chosen,
        images,
        scale,
        layout,
        tiers,
        pair,
        background,
        assignments,
        supersample,
        device,
        up,
        parse_window_size(size),
    )
    files.check(output)
    if files.any:
        _write(_read(path, options, output, headless=True), options, files, output)
        return
    probe = open_probe(files)
    try:
        state = _read(path, options, output, headless=False)
        if probe is not None:
            probe.check()
    finally:
        if probe is not None:
            probe.close()
    _open_window(state, options)


def _read(path: Path, options: CompareOptions, output: Output, *, headless: bool) -> CompareState:
    from msb.cli.inputs import open_asset
    from msb_viewers.deployment.state import CompareState

    with output.progress(f"reading {path.name}"):
        asset = open_asset(path, output)
    views, said = _views(options), ""
    if options.cameras is None:
        views, said = _chosen(asset, path, options)
    comparison = _comparison(asset, path, views, options, output, headless=headless)
    with about(path):
        state = CompareState.first(comparison, layout=options.layout, pair=options.pair, up=options.up)
    if said:
        output.note(f"views: {said}")
    return state


def _comparison(
    asset: Asset, path: Path, views: list[View], options: CompareOptions, output: Output, *, headless: bool
) -> Comparison:
    from msb.asset.settings import effective_settings, parse_overrides
    from msb.cli.camera_options import parse_background
    from msb.scenes.datasets import over_another, stated_background
    from msb_viewers.deployment.shots import Comparison, choose_tiers

    if options.cameras is not None and not any(view.photograph for view in views):
        output.note(f"{options.cameras}: no photograph of its cameras is there; --image-folder names them")
    tiers, missing = choose_tiers(asset, views, options.tiers, headless=headless)
    if options.tiers is None and headless and "reference" not in tiers:
        text = f"{asset.manifest.face_count:,} faces take NumPy minutes a view; --tiers names it if wanted"
        output.note(f"{path.name}: the reference is left out: {text}")
    settings = parse_overrides(asset.manifest.method, options.assignments or [])
    effective_settings(asset.manifest, settings)  # refuses what the asset cannot be drawn with
    color = parse_background(options.background, asset)
    own = stated_background(asset.manifest)
    if own not in (None, color) and any(view.photograph for view in views):
        output.note(over_another(own, color).to_line(path))
    return Comparison(
        path.name, asset, tiers, missing, tuple(views), settings, options.supersample, color, options.device
    )


def _chosen(asset: Asset, path: Path, options: CompareOptions) -> tuple[list[View], str]:
    """Return the views of the training or from inside, none where it is to be turned, and their words."""
    from msb.views import choose_views

    found = choose_views(asset, device=options.device)
    if found.origin == "turntable":
        return [], found.said
    views = _with_photographs(found.cameras, found.place or Path(), None, None)
    sizes = [min(1.0, max(TURNTABLE[1:]) / max(one.camera.width, one.camera.height)) for one in views]
    return [
        replace(one, camera=one.camera.scaled(size)) for one, size in zip(views, sizes, strict=True)
    ], found.said


def _views(options: CompareOptions) -> list[View]:
    if options.cameras is None:
        given = {"camera": options.chosen, "image-folder": options.images, "scale": options.scale}
        refuse(given, "needs --cameras PATH")
        return []
    from msb.cli.camera_options import choose_cameras
    from msb.scenes import read_cameras

    cameras = choose_cameras(read_cameras(options.cameras), options.chosen, None, None)
    return _with_photographs(cameras, Path(options.cameras), options.images, options.scale)


def _with_photographs(
    cameras: list[Camera], place: Path, images: Path | None, scale: float | None
) -> list[View]:
    """Return views of cameras that were read at `place`, with the photographs there or in `images`."""
    from msb.scenes.datasets import photographs_beside
    from msb_viewers.deployment.views import dataset_views

    beside = place if place.is_dir() else place.parent
    if images is not None:
        images = beside / images if (beside / images).is_dir() else images
    elif not any(camera.image_path and camera.image_path.is_file() for camera in cameras):
        found = photographs_beside(place, cameras)
        images = None if found is None else found[0]
    return dataset_views(cameras, images, scale, beside=beside)


def _write(state: CompareState, options: CompareOptions, files: Files, output: Output) -> None:
    from msb_viewers.deployment.compose import Composer
    from msb_viewers.deployment.page import write_page
    from msb_viewers.deployment.shots import TierRenderers
    from msb_viewers.deployment.views import View
    from msb_viewers.window import write_png

    state.message = ""
    with TierRenderers(state.comparison) as renderers:
        if files.html is not None:
            views = list(state.comparison.views) or state.around.turntable(*TURNTABLE)
            with output.counted("drawing", len(views)) as step:
                write_page(state, renderers, views, files.html, step=step)
        if files.screenshot is not None:
            with output.progress(f"writing {files.screenshot.name}"):
                view = state.view or View("free", state.picture_camera(options.size))
                shots = renderers.shoot_all(view, state.wanted_tiers())
                picture = Composer().compose(state, shots, options.size)
                write_png(picture.image, files.screenshot)
    if not output.quiet:
        echo("\n".join(str(path) for path in (files.html, files.screenshot) if path is not None))


def _open_window(state: CompareState, options: CompareOptions) -> None:
    from msb.cl import shared_device
    from msb_viewers.deployment.viewer import CompareViewer

    if any(tier in state.comparison.drawable for tier in ("dedicated", "standard")):
        shared_device(options.device)  # without one there is no window to be opened
    viewer = CompareViewer(state, size=options.size)
    try:
        viewer.show()
    finally:
        viewer.close()
