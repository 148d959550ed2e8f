"""Options that `msb view` and `msb compare` share: the files to write, and the size of a picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msb.base.option import Option
from msb.cli.output import file_option
from msb.errors import UsageError
from msb.render.options import MOST_PIXELS, Up, not_a_size, pixels_of
from msb_viewers.gl import GlProbe


@dataclass(frozen=True)
class Window:
    """The files to write, and the size and up axis of the picture. Without one `msb view` opens a window."""

    screenshot: Annotated[
        Path | None,
        file_option("Write a picture: .png.", endings=(".png",)),
    ] = None
    figure: Annotated[
        Path | None,
        file_option("Write the four-panel figure: .png, .svg or .pdf.", endings=(".png", ".svg", ".pdf")),
    ] = None
    html: Annotated[
        Path | None,
        file_option("Write a page that any browser opens, offline.", endings=(".html", ".htm")),
    ] = None
    up: Annotated[Up | None, Option("Axis that points up. Default: the asset's.")] = None
    size: Annotated[str, Option("Width and height of the picture in pixels.", metavar="WxH")] = "1280x800"

    def __post_init__(self) -> None:
        self.pixels  # noqa: B018 - refuses what is no size, before anything is read

    @property
    def written(self) -> list[Path]:
        """What is to be written."""
        return [path for path in (self.html, self.figure, self.screenshot) if path is not None]

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height."""
        if (size := pixels_of(self.size)) is None:
            raise not_a_size(self.size)
        width, height = size
        if not (64 <= width <= MOST_PIXELS and 64 <= height <= MOST_PIXELS):
            text = f"--size is {width}x{height}; it must be from 64 to {MOST_PIXELS} each way"
            raise UsageError("USAGE", text)
        return width, height


def open_probe(window: Window) -> GlProbe | None:
    """Ask whether GL can draw, if it is needed, and whether there is a display; GL's answer comes later."""
    from msb_viewers.gl import GlProbe, check_display

    if window.written == [window.html]:
        return None  # a page needs neither
    probe = GlProbe.start()
    if not window.written:
        try:
            check_display()
        except UsageError:
            probe.close()
            raise
    return probe
