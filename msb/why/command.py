"""`msb why`: print the loss of image quality from each cause, in dB of PSNR."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.base.option import Option
from msb.cli.command import Typed, command
from msb.cli.output import JsonOutput, Output
from msb.render.options import NO_CAMERAS, ONLY_GENERATED, RendererOptions, Source, ViewOptions

if TYPE_CHECKING:
    from msb.views import ChosenViews
    from msb.why import Cause, Causes


@command(
    "msb why --size 160x120 data_stubs/models/pebble/two_dts",
    "msb why --cameras data_stubs/views.json --scale 0.25 --save out/why \\\n      data_stubs/checkpoint",
)
def why(
    path: Source,
    views: ViewOptions,
    drawing: Annotated[RendererOptions, ("assignments", "device")],
    output: JsonOutput,
    save: Annotated[
        Path | None,
        Option(
            "Write an image for each cause into FOLDER. The left half shows the asset without this cause of "
            "quality loss, the right half with the cause.",
            metavar="FOLDER",
            output="own",
        ),
    ] = None,
    *,
    typed: Typed,
) -> None:
    """Explain why an export looks worse than the native rendering: measure the PSNR of each cause in dB.

    The asset is rendered with and without each cause. All other settings stay unchanged. Differences are
    clearly visible below 30 dB and invisible above 40 dB. The last lines compare the standard-tier mesh with
    the native rendering. This comparison measures the loss of all causes together. The report also separates
    two parts of the loss: the part due to engine settings, and the part due to the mesh. Engine settings
    avoid the first part of the loss, and a bake avoids the second part. Without --cameras the training
    cameras beside the asset are used. If the asset has no training cameras, cameras around the asset are
    used.
    """
    from msb.api.command_files import open_asset
    from msb.errors import about
    from msb.views import choose_views
    from msb.why import CAUSES
    from msb.why import why as measure

    if views.cameras is None:
        typed.reject(["camera"], NO_CAMERAS)
    else:
        typed.reject(["kind"], ONLY_GENERATED)
    if save is not None:
        for definition in CAUSES:
            output.check_free(save / f"{definition.name}.png", label="--save")
    size = views.pixels(640, 480) if views.cameras is None else (640, 480)
    asset = open_asset(path, output)
    cameras = None if views.cameras is None else views.read(output.note)
    device = drawing.device
    with about(path):
        chosen = choose_views(asset, cameras, size=size, device=device, kind=views.kind)
    color = views.color(asset)
    settings = drawing.settings(asset)
    with output.counted("drawing", len(CAUSES) + 1) as step, about(path):
        causes = measure(asset, chosen, background=color, settings=settings, device=device, step=step)
    used = causes.views
    head: dict[str, Any] = {
        "schema": "msb.why/1",
        "path": str(path),
        "method": asset.manifest.method,
        "views": len(used.cameras),
        "cameras": str(views.cameras or used.origin),
        "background": list(color),
    }
    listed = [cause.to_dict() for cause in causes]
    output.write_json({**head, "causes": listed, "total": causes.total.to_dict()})
    if save is not None:
        _save_images(causes, save, overwrite=output.force)
    if output.prints_text:
        _print(causes, head, used, save, output)


def _save_images(causes: list[Cause], folder: Path, *, overwrite: bool) -> None:
    """Write an image for each cause.

    The left half of the image shows the asset without this cause of quality loss, and the right half with the
    cause.
    """
    import numpy as np

    from msb.render.images import write_image

    for cause in causes:
        if cause.without is not None and cause.with_it is not None:
            gap = np.ones((len(cause.without), 4, 3), np.float32)
            image = np.concatenate([cause.without, gap, cause.with_it], axis=1)
            write_image(folder / f"{cause.name}.png", image, "png", overwrite=overwrite)


def _print(
    causes: Causes, head: dict[str, Any], views: ChosenViews, save: Path | None, output: Output
) -> None:
    """Print the table of causes, the loss of the standard-tier mesh, and the causes that do not apply."""
    from rich.markup import escape

    from msb.why.total import TITLE

    console = output.console()
    console.print(f"[bold]{escape(head['path'])}[/bold]: {head['method']}", soft_wrap=True)
    if (reason := views.why_not) is not None:
        console.print(escape(reason), soft_wrap=True)
        return
    if not output.quiet:
        console.print(escape(f"views: {views.description}"), soft_wrap=True)
        console.print("PSNR between the images with and without each cause. The difference is")
        console.print("clearly visible below 30 dB, and invisible above 40 dB.\n")
    measured = sorted((cause for cause in causes if cause.db is not None), key=lambda cause: cause.db or 0.0)
    rows = [
        (cause.title, _format_db(cause.db).removesuffix(" dB"), "" if output.quiet else cause.how_to_see)
        for cause in measured
    ]
    output.table(("Cause", "PSNR (dB)", "" if output.quiet else "How to recognise it"), rows, right=(1,))
    for line in _describe_total(causes, output.quiet):
        console.print(line, soft_wrap=output.quiet)
    if save is not None and not output.quiet:
        console.print(
            f"Images (left half without the cause, right half with the cause): {escape(str(save))}",
            soft_wrap=True,
        )
    absent = [cause for cause in causes if not cause.applies]
    if absent and not output.quiet:
        console.print("\nCauses that do not apply:")
        reasons = {cause.title: cause.reason for cause in absent}
        if causes.total.reason is not None:
            reasons[TITLE] = causes.total.reason
        for title, reason in reasons.items():
            console.print(f"- {escape(title)}: {escape(str(reason))}")


def _format_db(db: float | None) -> str:
    from msb.why import EQUAL

    return "equal" if db is None or db >= EQUAL else f"{db:.1f} dB"


def _describe_total(causes: Causes, quiet: bool) -> Iterator[str]:
    """Yield lines of text about the loss of the standard-tier mesh.

    The text separates the loss that settings avoid from the loss that a bake avoids.
    """
    from msb.why.total import TITLE

    total = causes.total
    if total.db is None:
        return
    yield f"\n[bold]{TITLE}: {_format_db(total.db)}[/bold]"
    if quiet:
        return
    sampled = "" if total.right == total.db else f" Supersampled as in training: {_format_db(total.right)}."
    yield (
        "- The loss of the mesh is not the sum of the causes above. A single wrong engine setting can cost "
        f"more.{sampled} With every engine setting wrong (lit, back faces culled, colours interpreted as "
        f"linear): {_format_db(total.wrong)}."
    )
    texts = {cause.name: f"{cause.title.lower()} ({_format_db(cause.db)})" for cause in causes}
    if total.bakes:
        together = "" if len(total.bakes) == 1 else f"; together {_format_db(total.baked)}"
        yield (
            "- The remaining loss cannot be avoided by settings. Run msb bake, which fits faces and colours "
            "of an opaque mesh to the native rendering, or use the method's shader. Visible causes: "
            f"{', '.join(texts[name] for name in total.bakes)}{together}."
        )
