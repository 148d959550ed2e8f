"""Draw text panels as images, which a viewer draws over its window: lines, lists and paragraphs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers.palette import INK, Color

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw as Draw
    from PIL.ImageFont import FreeTypeFont, ImageFont

FAINT: Color = (120, 122, 128)
PAPER = (255, 255, 255, 246)
EDGE = (190, 192, 196, 255)
# Width of a legend, height of a row, and width of the margin, in pixels at scale 1.
LEGEND_WIDTH, ROW, PAD = 322, 25, 12

# Minimum and maximum scale of text. Smaller text is not legible.
_SMALLEST, _LARGEST = 0.62, 2.0


@dataclass(frozen=True, eq=False)
class Panel:
    """An image (H, W, 4), and the actions of clicks on the image.

    `targets` are ranges of pixel rows (from, to), each with an action: a layer, "components" or "help".
    """

    image: NDArray[np.uint8]
    targets: tuple[tuple[int, int, str], ...] = ()

    def hit(self, x: float, y: float) -> str | None:
        """Return the action at x, y pixels from the top left corner.

        At a position without an action the result is "", and outside the panel it is None.
        """
        height, width = self.image.shape[:2]
        if not (0 <= x < width and 0 <= y < height):
            return None
        return next((action for top, bottom, action in self.targets if top <= y < bottom), "")


@lru_cache(maxsize=32)
def font(size: int, *, bold: bool = False) -> FreeTypeFont | ImageFont:
    """Return DejaVu Sans, which is part of matplotlib, or the default font of Pillow."""
    from PIL import ImageFont

    spec = find_spec("matplotlib")
    if spec is not None and spec.origin:
        folder = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"
        path = folder / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
        if path.exists():
            return ImageFont.truetype(str(path), size)
    return ImageFont.load_default(size)


class Sheet:
    """An image with text that is written from top to bottom.

    `draw_panel` draws the image twice. The first pass measures the height.
    """

    def __init__(self, width: int, height: int, scale: float) -> None:
        from PIL import Image, ImageDraw

        self.scale, self.width = scale, width
        self.picture = Image.new("RGBA", (width, height), (0, 0, 0, 0))
        self.draw: Draw = ImageDraw.Draw(self.picture)
        self.y = self.px(PAD)
        self.targets: list[tuple[int, int, str]] = []

    def px(self, value: float) -> int:
        """Return a length at scale 1 in pixels, at least one."""
        return max(round(value * self.scale), 1)

    def font(self, size: float, *, bold: bool = False) -> Any:
        """Return the font of a size at scale 1."""
        return font(max(round(size * self.scale), 7), bold=bold)

    def text(self, x: float, text: str, size: float = 13, color: Color = INK, **options: Any) -> None:
        """Write text in the current row, vertically centred.

        A negative x is the distance from the right side.
        """
        anchor = "lm" if x >= 0 else "rm"
        place = self.px(x) if x >= 0 else self.width - self.px(-x)
        middle = self.y + self.px(ROW) / 2
        self.draw.text((place, middle), text, color, self.font(size, **options), anchor=anchor)

    def paragraph(self, text: str, size: float = 12, color: Color = INK, **options: Any) -> None:
        """Write `text`, wrapped at the margin, and continue below the text."""
        face = self.font(size, **options)
        for line in wrap_text(text, face, self.width - 2 * self.px(PAD)):
            self.draw.text((self.px(PAD), self.y), line, color, face)
            self.y += self.px(size * 1.35)


def wrap_text(text: str, face: Any, width: float) -> list[str]:
    """Return the lines of `text`, each at most `width` pixels wide.

    Words longer than a line are shortened.
    """
    lines: list[str] = []
    line = ""
    for word in text.split():
        fitting = shorten_text(word, face, width)
        longer = f"{line} {fitting}".strip()
        if line and face.getlength(longer) > width:
            lines.append(line)
            longer = fitting
        line = longer
    return [*lines, line] if line else lines


def shorten_text(text: str, face: Any, width: float) -> str:
    """If `text` is wider than `width` pixels, replace its middle by dots. Return the text."""
    if face.getlength(text) <= width:
        return text
    keep = len(text) - 1
    while keep > 2:
        keep -= 1
        half = keep // 2
        short = f"{text[: keep - half]}...{text[len(text) - half :]}"
        if face.getlength(short) <= width:
            return short
    return text[:1]


def help_panel(rows: Iterable[tuple[str, str]], scale: float = 1.0) -> Panel:
    """Return an image with the list of keys and their actions."""

    def write(sheet: Sheet) -> None:
        sheet.paragraph("Keys and mouse", 15, bold=True)
        sheet.y += sheet.px(6)
        for keys, what in rows:
            sheet.text(12, keys, 12.5, bold=True)
            sheet.text(90, what, 12.5)
            sheet.y += sheet.px(22)
        sheet.y += sheet.px(8)

    return draw_panel(write, 400, scale)


def line_panel(text: str, width: int, scale: float = 1.0) -> Panel:
    """Return an image of one line of text.

    If the line is wider than `width` pixels, it is shortened in the middle.
    """
    face = font(max(round(13 * scale), 8))
    short = shorten_text(text, face, width - 24 * scale)
    wide = min(int(face.getlength(short) + 24 * scale), width) / scale

    def write(sheet: Sheet) -> None:
        sheet.y = 0
        sheet.text(12, short)
        sheet.y += sheet.px(ROW)

    return draw_panel(write, wide, scale)


def list_panel(title: str, text: str, lines: list[tuple[str, Color | None]], scale: float = 1.0) -> Panel:
    """Return an image with a title, a paragraph, and lines with a colour swatch (fan inspector)."""

    def write(sheet: Sheet) -> None:
        sheet.paragraph(title, 13, bold=True)
        sheet.paragraph(text, 12)
        sheet.y += sheet.px(3)
        for line, color in lines:
            left = 12
            if color is not None:
                top = sheet.y + sheet.px(6)
                box = (sheet.px(12), top, sheet.px(24), top + sheet.px(12))
                sheet.draw.rectangle(box, color, INK)
                left = 32
            sheet.text(left, line, 12)
            sheet.y += sheet.px(20)
        sheet.y += sheet.px(6)

    return draw_panel(write, LEGEND_WIDTH, scale)


def draw_panel(write: Callable[[Sheet], None], width: float, scale: float) -> Panel:
    """Return the panel that the function `write` draws. `width` is in pixels at scale 1.

    The height of the panel depends on the text.
    """
    trial = Sheet(round(width * scale), 4, scale)
    write(trial)
    sheet = Sheet(round(width * scale), trial.y + 1, scale)
    sheet.draw.rounded_rectangle((0, 0, sheet.width - 1, trial.y), sheet.px(6), PAPER, EDGE)
    write(sheet)
    return Panel(np.array(sheet.picture), tuple(sheet.targets))


def text_scale(size: tuple[int, int]) -> float:
    """Return the scale of text in a window of `size` pixels.

    >>> text_scale((1280, 800)), text_scale((320, 200))
    (1.0, 0.62)
    """
    return float(np.clip(min(size[0] / 1280, size[1] / 800), _SMALLEST, _LARGEST))


def write_png(image: NDArray[np.uint8], path: Path) -> None:
    """Write an image (H, W, 3) as a PNG file."""
    from PIL import Image

    from msb.base.atomic import new_file

    with new_file(path) as file:
        Image.fromarray(image).save(file, "PNG", optimize=True)
