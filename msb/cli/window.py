"""Options that `msb view` and `msb compare` share: a window, or files instead of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.cli.options import WRITTEN
from msb.errors import UsageError

if TYPE_CHECKING:
    from msb.cli.output import Output
    from msb_viewers.gl import GlProbe

UpAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Up = Annotated[UpAxis | None, typer.Option(help="Axis that points up. Default: the asset's.")]
Screenshot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write what the window would show to a .png."),
    WRITTEN,
]
Html = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write a page that any browser opens, offline."),
    WRITTEN,
]
WindowSize = Annotated[
    str, typer.Option("--size", metavar="WxH", help="Size of the window or screenshot in pixels.")
]
DEFAULT_SIZE = "1280x800"
MOST_PIXELS = 16384
"""The largest width or height of a picture, in pixels; GL draws no more."""


@dataclass(frozen=True)
class Files:
    """The files to write; without any a window opens."""

    screenshot: Path | None = None
    figure: Path | None = None
    html: Path | None = None

    @property
    def any(self) -> bool:
        """Whether something is to be written."""
        return any(path is not None for path in (self.screenshot, self.figure, self.html))

    def check(self, output: Output) -> None:
        """Refuse names with wrong suffixes and outputs that exist, before anything is read."""
        from msb.api.saving import checked_ending

        for option, path, suffixes in (
            ("--screenshot", self.screenshot, (".png",)),
            ("--figure", self.figure, (".png", ".svg", ".pdf")),
            ("--html", self.html, (".html", ".htm")),
        ):
            if path is not None:
                checked_ending(path, option, suffixes)
            output.check_free(path)


def open_probe(files: Files) -> GlProbe | None:
    """Ask whether GL can draw, if it is needed, and whether there is a display; GL's answer comes later."""
    from msb_viewers.gl import GlProbe, check_display

    if files.any and files.screenshot is None and files.figure is None:
        return None  # a page needs neither
    probe = GlProbe.start()
    if not files.any:
        try:
            check_display()
        except UsageError:
            probe.close()
            raise
    return probe


def parse_window_size(text: str) -> tuple[int, int]:
    """Return width and height of a text like 1280x800."""
    from msb.cli.camera_options import parse_size

    width, height = parse_size(text)
    if not (64 <= width <= MOST_PIXELS and 64 <= height <= MOST_PIXELS):
        raise UsageError("USAGE", f"--size is {width}x{height}; it must be from 64 to {MOST_PIXELS} each way")
    return width, height
