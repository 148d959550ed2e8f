"""Options that `msb view` and `msb compare` share: output files, image size and up axis."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msb.base.option import Option
from msb.cli.output import file_option
from msb.errors import UsageError
from msb.render.options import MOST_PIXELS, Up, not_a_size, parse_size
from msb_viewers.gl import GlProbe


@dataclass(frozen=True)
class Window:
    """Output files, image size and up axis. Without an output file `msb view` opens a window."""

    screenshot: Annotated[
        Path | None,
        file_option("Write an image (.png).", endings=(".png",)),
    ] = None
    figure: Annotated[
        Path | None,
        file_option("Write a figure for print (.png, .svg, .pdf).", endings=(".png", ".svg", ".pdf")),
    ] = None
    html: Annotated[
        Path | None,
        file_option("Write a web page that works offline in any browser.", endings=(".html", ".htm")),
    ] = None
    up: Annotated[Up | None, Option("Axis that points up. Default: the up axis of the asset.")] = None
    size: Annotated[str, Option("Width and height of the image in pixels.", metavar="WxH")] = "1280x800"

    def __post_init__(self) -> None:
        self.pixels  # noqa: B018 - rejects an invalid size before reading files

    @property
    def written(self) -> list[Path]:
        """The output files."""
        return [path for path in (self.html, self.figure, self.screenshot) if path is not None]

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height in pixels."""
        if (size := parse_size(self.size)) is None:
            raise not_a_size(self.size)
        width, height = size
        if not (64 <= width <= MOST_PIXELS and 64 <= height <= MOST_PIXELS):
            text = f"--size is {width}x{height}; width and height must be 64 to {MOST_PIXELS}"
            raise UsageError("USAGE", text)
        return width, height


def open_probe(window: Window) -> GlProbe | None:
    """If the outputs need OpenGL, start the test of OpenGL.

    If a window is opened, check that a display exists.
    """
    from msb_viewers.gl import GlProbe, check_display

    if window.written == [window.html]:
        return None  # a page needs neither OpenGL nor a display
    probe = GlProbe.start()
    if not window.written:
        try:
            check_display()
        except UsageError:
            probe.close()
            raise
    return probe
