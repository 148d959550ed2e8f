"""`msb view --web`: the mesh any engine draws, on a page of three.js that needs nothing but a browser."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.cli.output import echo

if TYPE_CHECKING:
    from pathlib import Path

    from msb.cli.output import Output

WEB_BACKGROUND = "white"


def write_web(
    target: Path,
    path: Path | None,
    output: Output,
    *,
    cameras: str | None,
    chosen: list[str] | None,
    scale: float | None,
    background: str | None,
    assignments: list[str] | None,
    up: str | None,
) -> None:
    """Write the page, with the standard-tier mesh of `path` in it, or empty. Raises as `msb render`."""
    from msb.engines.webpage import write_web_page
    from msb.errors import UsageError

    if target.suffix.lower() not in (".html", ".htm"):
        raise UsageError("USAGE", f'--web: "{target.name}" must end in .html, .htm')
    output.check_free(target)
    if path is None:
        write_web_page(target, background=(1.0, 1.0, 1.0))
    else:
        from msb.asset.settings import parse_overrides
        from msb.cli.views import choose_cameras, open_asset, parse_background
        from msb.engines.mesh import engine_mesh
        from msb.engines.webpage import LARGE
        from msb.scenes import read_cameras

        with output.progress(f"reading {path.name}"):
            asset = open_asset(path)
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
                background=parse_background(background or WEB_BACKGROUND, asset),
            )
    if not output.quiet:
        echo(str(target))
