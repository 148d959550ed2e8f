"""`msb view --compare`: what the paths of deployment make of an asset's look."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from msb.cli.output import echo

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.output import Output
    from msb.cli.view import Files
    from msb_viewers.deployment.shots import Comparison
    from msb_viewers.deployment.state import CompareState
    from msb_viewers.deployment.views import View

Layout = Literal["side", "wipe", "difference"]
TURNTABLE = (8, 640, 480)
"""Views of a page without cameras: how many, width, height."""


@dataclass(frozen=True)
class CompareOptions:
    """What to compare, as the command line has it."""

    cameras: str | None = None
    chosen: list[str] | None = None
    images: Path | None = None
    scale: float | None = None
    layout: Layout = "side"
    paths: list[str] | None = None
    pair: str | None = None
    background: str = "white"
    assignments: list[str] | None = None
    supersample: int = 1
    device: str | None = None
    up: str | None = None
    size: tuple[int, int] = (1280, 800)


def compare(path: Path, options: CompareOptions, files: Files, output: Output) -> None:
    """Write what is asked for, or open the window and return when it is closed. Raises as `msb render`."""
    if not files.any:
        from msb.cli.view import open_probe

        probe = open_probe(files)
        try:
            state = _read(path, options, output, headless=False)
            if probe is not None:
                probe.check()
        finally:
            if probe is not None:
                probe.close()
        _open_window(state, options)
        return
    state = _read(path, options, output, headless=True)
    _write(state, options, files, output)


def _read(path: Path, options: CompareOptions, output: Output, *, headless: bool) -> CompareState:
    from msb.cli.run import about
    from msb.cli.views import open_asset
    from msb_viewers.deployment.state import CompareState

    with output.progress(f"reading {path.name}"):
        asset = open_asset(path)
    comparison = _comparison(asset, path, options, output, headless=headless)
    with about(path):
        return CompareState.first(comparison, layout=options.layout, pair=options.pair, up=options.up)


def _comparison(
    asset: Asset, path: Path, options: CompareOptions, output: Output, *, headless: bool
) -> Comparison:
    from msb.asset.settings import effective_settings, parse_overrides
    from msb.cli.views import parse_background
    from msb_viewers.deployment.shots import Comparison, choose_paths

    views = _views(options)
    if views and not any(view.photograph for view in views):
        output.note(f"{options.cameras}: no photograph of its cameras is there; --images FOLDER names them")
    paths, missing = choose_paths(asset, views, options.paths, headless=headless)
    if options.paths is None and headless and "reference" not in paths:
        text = f"{asset.manifest.face_count:,} faces take NumPy minutes a view; --paths names it if wanted"
        output.note(f"{path.name}: the reference is left out: {text}")
    settings = parse_overrides(asset.manifest.method, options.assignments or [])
    effective_settings(asset.manifest, settings)  # refuses what the asset cannot be drawn with
    color = parse_background(options.background, asset)
    return Comparison(
        path.name, asset, paths, missing, tuple(views), settings, options.supersample, color, options.device
    )


def _views(options: CompareOptions) -> list[View]:
    from msb.errors import UsageError

    if options.cameras is None:
        for name, value in (
            ("camera", options.chosen),
            ("images", options.images),
            ("scale", options.scale),
        ):
            if value is not None:
                raise UsageError("USAGE", f"--{name} needs --cameras PATH")
        return []
    from msb.cli.views import choose_cameras
    from msb.scenes import read_cameras
    from msb_viewers.deployment.views import dataset_views

    cameras = choose_cameras(read_cameras(options.cameras), options.chosen, None, None)
    place = Path(options.cameras)
    beside = place if place.is_dir() else place.parent
    return dataset_views(cameras, options.images, options.scale, beside=beside)


def _write(state: CompareState, options: CompareOptions, files: Files, output: Output) -> None:
    from msb_viewers.deployment.compose import Composer
    from msb_viewers.deployment.page import write_page
    from msb_viewers.deployment.shots import PathRenderers
    from msb_viewers.deployment.views import View
    from msb_viewers.window import write_png

    state.message = ""
    with PathRenderers(state.comparison) as renderers:
        if files.html is not None:
            views = list(state.comparison.views) or state.around.turntable(*TURNTABLE)
            with output.counted("drawing", len(views)) as step:
                write_page(state, renderers, views, files.html, step=step)
        if files.screenshot is not None:
            with output.progress(f"writing {files.screenshot.name}"):
                view = state.view or View("free", state.picture_camera(options.size))
                shots = renderers.shoot_all(view, state.wanted_paths())
                picture = Composer().compose(state, shots, options.size)
                write_png(picture.image, files.screenshot)
    if not output.quiet:
        echo("\n".join(str(path) for path in (files.html, files.screenshot) if path is not None))


def _open_window(state: CompareState, options: CompareOptions) -> None:
    from msb.cl import open_device
    from msb_viewers.deployment.viewer import CompareViewer

    if any(path in state.comparison.drawable for path in ("dedicated", "standard")):
        open_device(options.device).close()  # without one there is no window to be opened
    viewer = CompareViewer(state, size=options.size)
    try:
        viewer.show()
    finally:
        viewer.close()
