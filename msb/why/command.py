"""`msb why`: what each cause of a worse look costs an asset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.base.option import Option
from msb.cli.command import Typed, command
from msb.cli.output import JsonOutput, Output
from msb.render.options import NO_CAMERAS, Drawing, Source, Views

if TYPE_CHECKING:
    from msb.views import Views as Chosen
    from msb.why import Cause, Causes


@command(
    "msb why --size 160x120 data_stubs/models/pebble/two_dts",
    "msb why --cameras data_stubs/views.json --scale 0.25 --save out/why \\\n      data_stubs/checkpoint",
)
def why(
    path: Source,
    views: Views,
    drawing: Annotated[Drawing, ("assignments", "device")],
    output: JsonOutput,
    save: Annotated[
        Path | None,
        Option("Write a picture of each cause: without it, and with it.", metavar="FOLDER", output="own"),
    ] = None,
    *,
    typed: Typed,
) -> None:
    """Say why an export looks worse than the render: what each cause costs, in dB.

    The asset is drawn with each cause and without it, everything else alike. Below 30 dB the difference is
    plain to see, above 40 dB it is not. The last lines are of all of it at once: the standard tier against
    the method's own look, what engine settings mend of that, and what only a bake could. Without --cameras
    it is seen by those of its training where they lie beside it, else from around.
    """
    from msb.api.command_files import open_asset
    from msb.errors import about
    from msb.views import choose_views
    from msb.why import CAUSES
    from msb.why import why as find

    if views.cameras is None:
        typed.reject(["camera"], NO_CAMERAS)
    if save is not None:
        for known in CAUSES:
            output.check_free(save / f"{known.name}.png")
    size = views.pixels(640, 480) if views.cameras is None else (640, 480)
    asset = open_asset(path, output)
    given = None if views.cameras is None else views.read(output.note)
    device = drawing.device
    with about(path):
        chosen = choose_views(asset, given, size=size, device=device)
    color = views.color(asset)
    settings = drawing.settings(asset)
    with output.counted("drawing", len(CAUSES) + 1) as step, about(path):
        causes = find(asset, chosen, background=color, settings=settings, device=device, step=step)
    seen = causes.views
    where: dict[str, Any] = {"views": len(seen.cameras)}
    where |= {"cameras": str(views.cameras or seen.origin), "background": list(color)}
    head = {"schema": "msb.why/1", "path": str(path), "method": asset.manifest.method, **where}
    listed = [cause.to_dict() for cause in causes]
    output.write_json({**head, "causes": listed, "total": causes.total.to_dict()})
    if save is not None:
        _save(causes, save, overwrite=output.force)
    if output.prints_text:
        _print(causes, head, seen, save, output)


def _save(causes: list[Cause], folder: Path, *, overwrite: bool) -> None:
    import numpy as np

    from msb.render.images import write_image

    for cause in causes:
        if cause.without is not None and cause.with_it is not None:
            gap = np.ones((len(cause.without), 4, 3), np.float32)
            picture = np.concatenate([cause.without, gap, cause.with_it], axis=1)
            write_image(folder / f"{cause.name}.png", picture, "png", overwrite=overwrite)


def _print(causes: Causes, head: dict[str, Any], views: Chosen, save: Path | None, output: Output) -> None:
    from rich.markup import escape

    from msb.why import EQUAL

    console = output.console()
    console.print(f"[bold]{escape(head['path'])}[/bold]: {head['method']}", soft_wrap=True)
    if not views.cameras:
        console.print(escape(views.nothing), soft_wrap=True)
        return
    if not output.quiet:
        console.print(escape(f"views: {views.said}"), soft_wrap=True)
    rows = []
    shown = sorted((one for one in causes if one.db is not None), key=lambda one: one.db or 0.0)
    for cause in shown:
        db = "equal" if cause.db is None or cause.db >= EQUAL else f"{cause.db:.1f}"
        rows.append((cause.title, db, "" if output.quiet else cause.how_to_see))
    output.table(("Cause", "dB", "" if output.quiet else "How to see whether it is yours"), rows, right=(1,))
    for line in _total(causes, output.quiet):
        console.print(line, soft_wrap=output.quiet)
    if save is not None and not output.quiet:
        console.print(f"pictures, each without and with its cause: {escape(str(save))}", soft_wrap=True)
    absent = [one for one in causes if not one.applies]
    if absent and not output.quiet:
        console.print("\nNot causes here:")
        reasons = {cause.title: cause.reason for cause in absent}
        if causes.total.reason is not None:
            reasons["All of it at once"] = causes.total.reason
        for title, reason in reasons.items():
            console.print(f"- {escape(title)}: {escape(str(reason))}")


def _total(causes: Causes, quiet: bool) -> Iterator[str]:
    """Yield what all causes do at once, and what of it can be mended where."""
    from msb.why import EQUAL
    from msb.why.total import TITLE

    total = causes.total

    def decibels(db: float | None) -> str:
        return "equal" if db is None or db >= EQUAL else f"{db:.1f} dB"

    if total.db is None:
        return
    yield f"\n[bold]{TITLE}: {decibels(total.db)}[/bold]"
    if quiet:
        return
    sampled = "" if total.right == total.db else ", supersampled as in training"
    yield (
        f"- Engine settings: {decibels(total.wrong)} with all of them wrong (lit, back faces culled, colours "
        f"taken for linear); {decibels(total.right)} is what is left with all of them right (unlit, "
        f"two-sided, colours as they are{sampled})."
    )
    of = {cause.name: f"{cause.title.lower()} ({decibels(cause.db)})" for cause in causes}
    if total.bakes:
        together = "" if len(total.bakes) == 1 else f"; together {decibels(total.baked)}"
        yield (
            "- What is left no setting mends, only msb bake (faces and colours made anew for an opaque mesh) "
            f"or the method's own shader: {', '.join(of[name] for name in total.bakes)}{together}."
        )
