"""`msb compare`: a model's tiers beside its photographs, as a page or a picture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msb.base.option import Option
from msb.cli.command import Typed, command, require
from msb.cli.output import Output, PlainOutput, echo
from msb.errors import about
from msb.render.options import NO_CAMERAS, Drawing, Source, Views, check_factor
from msb_viewers.commands.window import Window

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb_viewers.deployment.shots import Comparison
    from msb_viewers.deployment.state import CompareState
    from msb_viewers.deployment.views import View

# The number of views where neither cameras nor a training give any, and their width and height in pixels.
TURNTABLE = (8, 640, 480)


@dataclass(frozen=True)
class CompareOptions:
    """What is compared, and how it is shown at first."""

    image_folder: Annotated[
        Path | None,
        Option(
            "The photographs' folder in the scene, e.g. images_2, or any other. Default: where the dataset "
            "says, or else the largest that are there.",
            ("--image-folder", "--images"),
            metavar="NAME|FOLDER",
        ),
    ] = None
    scale: Annotated[
        float | None, Option("Size of the pictures relative to the cameras' own.", metavar="FACTOR")
    ] = None
    layout: Annotated[Literal["side", "wipe", "difference"], Option("How pictures are shown (at first).")] = (
        "side"
    )
    tiers: Annotated[
        tuple[str, ...],
        Option(
            "Some of reference, dedicated, standard, baked and truth (photographs). Default: all.",
            metavar="TIERS",
        ),
    ] = ()
    baked: Annotated[
        Path | None, Option("Also show this plain asset, which msb bake made of it.", metavar="FILE")
    ] = None
    pair: Annotated[str | None, Option("Tiers that wipe and difference show at first.", metavar="A,B")] = None

    def __post_init__(self) -> None:
        if self.scale is not None:
            check_factor(self.scale)


@dataclass(frozen=True)
class _Wish:
    """All that was asked for."""

    options: CompareOptions
    views: Views
    drawing: Drawing
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
    views: Annotated[Views, ("cameras", "camera", "background")],
    options: CompareOptions,
    drawing: Annotated[Drawing, ("assignments", "supersample", "device")],
    output: PlainOutput,
    typed: Typed,
) -> None:
    """Compare a model's tiers with each other and with the dataset's photographs.

    Pictures stand side by side, with a wipe, or as a map of their difference with its PSNR. --html writes a
    page of all views that switches between these layouts, --screenshot a picture of the first view. Without
    --cameras the views are those of its training where they lie beside it, else from around.
    """
    if views.cameras is None:
        typed.reject(["camera", "image_folder", "scale"], NO_CAMERAS)
    require(window.written, "Missing output. Pass --html FILE.html or --screenshot FILE.png")
    wish = _Wish(options, views, drawing, window)
    _write(_read(path, wish, output), wish, output)


def _read(path: Path, wish: _Wish, output: Output) -> CompareState:
    from msb.api.command_files import open_asset
    from msb_viewers.deployment.state import CompareState

    asset = open_asset(path, output)
    views, said = _chosen(asset, wish) if wish.views.cameras is None else (_given(wish), "")
    comparison = _comparison(asset, path, views, wish, output)
    options = wish.options
    with about(path):
        state = CompareState.first(comparison, layout=options.layout, pair=options.pair)
    if said:
        output.note(f"views: {said}")
    return state


def _comparison(asset: Asset, path: Path, views: list[View], wish: _Wish, output: Output) -> Comparison:
    from msb.api.command_files import open_baked
    from msb.asset.settings import effective_settings
    from msb.scenes.datasets import over_another, stated_background
    from msb_viewers.deployment.shots import Comparison, choose_tiers

    cameras, drawing = wish.views.cameras, wish.drawing
    photographs = any(view.photograph for view in views)
    if cameras is not None and not photographs:
        output.note(f"{cameras}: no photograph of its cameras is there; --image-folder names them")
    baked = None if wish.options.baked is None else open_baked(wish.options.baked, asset, output)
    tiers, missing = choose_tiers(asset, views, wish.options.tiers or None, baked=baked)
    if not wish.options.tiers and "reference" not in tiers:
        text = f"{asset.manifest.face_count:,} faces take NumPy minutes a view; --tiers names it if wanted"
        output.note(f"{path.name}: the reference is left out: {text}")
    settings = drawing.settings(asset)
    effective_settings(asset.manifest, settings)  # refuses what the asset cannot be drawn with
    color = wish.views.color(asset)
    own = stated_background(asset.manifest)
    if own not in (None, color) and photographs:
        output.note(over_another(own, color).to_line(path))
    made = (path.name, asset, tiers, missing, tuple(views), settings, drawing.supersample, color)
    return Comparison(*made, drawing.device, baked)


def _chosen(asset: Asset, wish: _Wish) -> tuple[list[View], str]:
    """Return the views that judge a model without cameras, and their words; --up turns a turntable."""
    from msb.scenes.around import around
    from msb.views import choose_views
    from msb_viewers.deployment.views import View, views_at

    chosen = choose_views(asset, device=wish.drawing.device)
    if chosen.origin == "turntable":
        cameras = around(asset, *TURNTABLE, up=wish.window.up)
        views = [View(f"view {index}", camera, why="") for index, camera in enumerate(cameras, 1)]
        return views, chosen.said
    views = views_at(chosen.cameras, chosen.place or Path(), None, None)
    sizes = [min(1.0, max(TURNTABLE[1:]) / max(one.camera.width, one.camera.height)) for one in views]
    return [
        replace(one, camera=one.camera.scaled(size)) for one, size in zip(views, sizes, strict=True)
    ], chosen.said


def _given(wish: _Wish) -> list[View]:
    from msb.scenes import read_cameras
    from msb_viewers.deployment.views import views_at

    place = wish.views.cameras or Path()
    cameras = wish.views.of(read_cameras(place))
    return views_at(cameras, place, wish.options.image_folder, wish.options.scale)


def _write(state: CompareState, wish: _Wish, output: Output) -> None:
    from msb_viewers.deployment.compose import compose
    from msb_viewers.deployment.page import write_page
    from msb_viewers.deployment.shots import TierRenderers
    from msb_viewers.sheet import write_png

    window = wish.window
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
