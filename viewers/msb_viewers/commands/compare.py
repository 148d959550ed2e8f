"""`msb compare`: compare the tiers of a model with its photographs, on a page or in an image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msb.base.option import Option
from msb.cli.command import Typed, command, require
from msb.cli.output import Output, PlainOutput, echo
from msb.errors import about
from msb.render.options import (
    NO_CAMERAS,
    ONLY_GENERATED,
    RendererOptions,
    Source,
    ViewOptions,
    check_factor,
)
from msb_viewers.commands.window import Window

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb_viewers.deployment.shots import Comparison
    from msb_viewers.deployment.state import CompareState
    from msb_viewers.deployment.views import View

# Turntable for models without cameras: the number of views, and their width and height in pixels. Views of
# training cameras are scaled down to the same longest side.
TURNTABLE = (8, 640, 480)


@dataclass(frozen=True)
class CompareOptions:
    """Compared tiers and photographs, and the first layout."""

    image_folder: Annotated[
        Path | None,
        Option(
            "Folder of the photographs: its name in the scene, e.g. images_2, or any path. Default: the "
            "folder of the dataset, or else the one with the largest images.",
            ("--image-folder", "--images"),
            metavar="NAME|FOLDER",
        ),
    ] = None
    scale: Annotated[
        float | None, Option("Size of the images relative to the cameras.", metavar="FACTOR")
    ] = None
    layout: Annotated[
        Literal["side", "wipe", "difference"], Option("Layout of the image, and the first one of the page.")
    ] = "side"
    tiers: Annotated[
        tuple[str, ...],
        Option(
            "Tiers to show: reference, dedicated, standard, baked, truth (photographs). Default: all.",
            metavar="TIERS",
        ),
    ] = ()
    baked: Annotated[
        Path | None, Option("Also show this mesh, which msb bake made from the model.", metavar="FILE")
    ] = None
    pair: Annotated[str | None, Option("The two tiers that wipe and difference compare.", metavar="A,B")] = (
        None
    )

    def __post_init__(self) -> None:
        if self.scale is not None:
            check_factor(self.scale)


@dataclass(frozen=True)
class _Request:
    """All options of the command."""

    options: CompareOptions
    views: ViewOptions
    drawing: RendererOptions
    window: Window


@command(
    "msb compare --html out/compare.html data_stubs/checkpoint",
    "msb compare --layout wipe --screenshot out/w.png data_stubs/checkpoint",
    "msb compare --tiers dedicated,standard --html out/c.html \\\n"
    "      --cameras data_stubs/views.json --scale 0.25 data_stubs/checkpoint",
)
def compare(
    path: Source,
    window: Annotated[Window, ("screenshot", "html", "up", "size")],
    views: Annotated[ViewOptions, ("cameras", "camera", "background", "kind")],
    options: CompareOptions,
    drawing: Annotated[RendererOptions, ("assignments", "supersample", "device")],
    output: PlainOutput,
    typed: Typed,
) -> None:
    """Compare the tiers of a model with each other and with the photographs of the dataset.

    Images are shown side by side, with a wipe, or as a map of their difference with the PSNR. --html writes a
    page of all views that can switch between these layouts, --screenshot an image of the first view. Without
    --cameras the cameras of the training are used, if they are found next to the model, otherwise a
    turntable.
    """
    if views.cameras is None:
        typed.reject(["camera", "image_folder", "scale"], NO_CAMERAS)
    else:
        typed.reject(["kind"], ONLY_GENERATED)
    require(window.written, "Missing output. Pass --html FILE.html or --screenshot FILE.png")
    request = _Request(options, views, drawing, window)
    _write(_read(path, request, output), request, output)


def _read(path: Path, request: _Request, output: Output) -> CompareState:
    from msb.api.command_files import open_asset
    from msb_viewers.deployment.state import CompareState

    asset = open_asset(path, output)
    views, source = _choose(asset, request) if request.views.cameras is None else (_read_cameras(request), "")
    comparison = _comparison(asset, path, views, request, output)
    options = request.options
    with about(path):
        state = CompareState.first(comparison, layout=options.layout, pair=options.pair)
    if source:
        output.note(f"views: {source}")
    return state


def _comparison(asset: Asset, path: Path, views: list[View], request: _Request, output: Output) -> Comparison:
    from msb.api.command_files import open_baked
    from msb.asset.settings import effective_settings
    from msb.scenes.datasets import stated_background, warn_background
    from msb_viewers.deployment.shots import Comparison, choose_tiers

    cameras, drawing = request.views.cameras, request.drawing
    photographs = any(view.photograph for view in views)
    if cameras is not None and not photographs:
        output.note(f"{cameras}: no photographs were found for these cameras; pass --image-folder")
    baked = None if request.options.baked is None else open_baked(request.options.baked, asset, output)
    tiers, missing = choose_tiers(asset, views, request.options.tiers or None, baked=baked)
    if not request.options.tiers and "reference" not in tiers:
        text = f"{asset.manifest.face_count:,} faces take minutes per view; list it in --tiers to include it"
        output.note(f"{path.name}: the reference tier is omitted: {text}")
    settings = drawing.settings(asset)
    effective_settings(asset.manifest, settings)  # rejects invalid settings
    color = request.views.color(asset)
    stated = stated_background(asset.manifest)
    if stated not in (None, color) and photographs:
        output.note(warn_background(stated, color).to_line(path))
    content = (path.name, asset, tiers, missing, tuple(views), settings, drawing.supersample, color)
    return Comparison(*content, drawing.device, baked)


def _choose(asset: Asset, request: _Request) -> tuple[list[View], str]:
    """Return the views without --cameras, and their description; --up sets the axis of a turntable."""
    from msb.scenes.around import make_turntable
    from msb.views import choose_views
    from msb_viewers.deployment.views import View, views_at

    chosen = choose_views(asset, device=request.drawing.device, kind=request.views.kind)
    if chosen.origin == "turntable":
        cameras = make_turntable(asset, *TURNTABLE, up=request.window.up)
        views = [View(f"view {index}", camera, why="") for index, camera in enumerate(cameras, 1)]
        return views, chosen.description
    views = views_at(chosen.cameras, chosen.place or Path(), None, None)
    # Scale down large views of the training.
    sizes = [min(1.0, max(TURNTABLE[1:]) / max(view.camera.width, view.camera.height)) for view in views]
    return [
        replace(view, camera=view.camera.scaled(size)) for view, size in zip(views, sizes, strict=True)
    ], chosen.description


def _read_cameras(request: _Request) -> list[View]:
    """Return the views of --cameras, with their photographs."""
    from msb.scenes import read_cameras
    from msb_viewers.deployment.views import views_at

    place = request.views.cameras or Path()
    cameras = request.views.of(read_cameras(place))
    return views_at(cameras, place, request.options.image_folder, request.options.scale)


def _write(state: CompareState, request: _Request, output: Output) -> None:
    from msb_viewers.deployment.compose import compose
    from msb_viewers.deployment.page import write_page
    from msb_viewers.deployment.shots import TierRenderers
    from msb_viewers.sheet import write_png

    window = request.window
    with TierRenderers(state.comparison) as renderers:
        if window.html is not None:
            views = list(state.comparison.views)
            with output.counted("drawing", len(views)) as step:
                write_page(state, renderers, views, window.html, step=step)
        if window.screenshot is not None:
            with output.progress(f"writing {window.screenshot.name}"):
                shots = renderers.shoot_all(state.comparison.views[0], state.wanted_tiers())
                write_png(compose(state, shots, window.pixels).image, window.screenshot)
    if not output.quiet:
        echo("\n".join(map(str, window.written)))
