"""The legend, the help and the status line as pictures, and which row of the legend a click meets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from msb_viewers.palette import BLACK, HIGHLIGHT, INK, SIZE_CLASSES, Color, Style
from msb_viewers.state import HELP, component_rows, legend_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.ImageDraw import ImageDraw as Draw
    from PIL.ImageFont import FreeTypeFont, ImageFont

    from msb_viewers.state import ViewState

FAINT: Color = (120, 122, 128)
PAPER = (255, 255, 255, 246)
EDGE = (190, 192, 196, 255)
_WIDTH, _ROW, _PAD = 322, 25, 12
"""Of the legend at scale 1, in pixels."""


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture, and what a click on it means.

    Attributes
    ----------
    image : (H, W, 4) uint8
        Row 0 at the top.
    targets : tuple of (top, bottom, action)
        Rows of pixels and what they stand for: a layer's kind, "components" or "help".
    """

    image: NDArray[np.uint8]
    targets: tuple[tuple[int, int, str], ...] = ()

    def hit(self, x: float, y: float) -> str | None:
        """Return the action of the row at x, y pixels from the top left corner, if there is one."""
        height, width = self.image.shape[:2]
        if not (0 <= x < width and 0 <= y < height):
            return None
        return next((action for top, bottom, action in self.targets if top <= y < bottom), "")


@lru_cache(maxsize=32)
def font(size: int, *, bold: bool = False) -> FreeTypeFont | ImageFont:
    """Return DejaVu Sans, which comes with matplotlib, or else Pillow's own font."""
    from PIL import ImageFont

    spec = find_spec("matplotlib")
    if spec is not None and spec.origin:
        folder = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"
        path = folder / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
        if path.exists():
            return ImageFont.truetype(str(path), size)
    return ImageFont.load_default(size)


class _Sheet:
    """A picture that grows downwards: drawn once to find its height, once for good."""

    def __init__(self, width: int, height: int, scale: float) -> None:
        from PIL import Image, ImageDraw

        self.scale, self.width = scale, width
        self.picture = Image.new("RGBA", (width, height), (0, 0, 0, 0))
        self.draw: Draw = ImageDraw.Draw(self.picture)
        self.y = self.px(_PAD)
        self.targets: list[tuple[int, int, str]] = []

    def px(self, value: float) -> int:
        return max(round(value * self.scale), 1)

    def font(self, size: float, *, bold: bool = False) -> Any:
        return font(max(round(size * self.scale), 7), bold=bold)

    def text(self, x: float, text: str, size: float = 13, color: Color = INK, **options: Any) -> None:
        """Write on the middle of the present row; a negative x is from the right."""
        anchor = "lm" if x >= 0 else "rm"
        place = self.px(x) if x >= 0 else self.width - self.px(-x)
        middle = self.y + self.px(_ROW) / 2
        self.draw.text((place, middle), text, color, self.font(size, **options), anchor=anchor)

    def paragraph(self, text: str, size: float = 12, color: Color = INK, **options: Any) -> None:
        """Write wrapped text and go on below it."""
        face = self.font(size, **options)
        for line in wrapped(text, face, self.width - 2 * self.px(_PAD)):
            self.draw.text((self.px(_PAD), self.y), line, color, face)
            self.y += self.px(size * 1.35)


def wrapped(text: str, face: Any, width: float) -> list[str]:
    """Return `text` in lines at most `width` pixels wide; a word that is wider is cut short."""
    lines: list[str] = []
    line = ""
    for word in text.split():
        fitted = shortened(word, face, width)
        longer = f"{line} {fitted}".strip()
        if line and face.getlength(longer) > width:
            lines.append(line)
            longer = fitted
        line = longer
    return [*lines, line] if line else lines


def shortened(text: str, face: Any, width: float) -> str:
    """Return `text`, with dots in its middle if it is wider than `width` pixels."""
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


def legend_panel(state: ViewState, scale: float = 1.0) -> Panel:
    """Return the legend: what is shown, check boxes, counts, keys and the verdict."""
    return _grown(lambda sheet: _legend(sheet, state), _WIDTH, scale)


def help_panel(scale: float = 1.0) -> Panel:
    """Return the list of keys."""
    return _grown(_help, 400, scale)


def line_panel(text: str, width: int, scale: float = 1.0) -> Panel:
    """Return one line of text, as wide as it needs, at most `width` pixels; then it is cut in the middle."""
    face = font(max(round(13 * scale), 8))
    shown = shortened(text, face, width - 24 * scale)
    wide = min(int(face.getlength(shown) + 24 * scale), width) / scale

    def write(sheet: _Sheet) -> None:
        sheet.y = 0
        sheet.text(12, shown)
        sheet.y += sheet.px(_ROW)

    return _grown(write, wide, scale)


def list_panel(title: str, text: str, lines: list[tuple[str, Color | None]], scale: float = 1.0) -> Panel:
    """Return a title, a text, and lines with a swatch of their colour: what the fan inspector says."""

    def write(sheet: _Sheet) -> None:
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

    return _grown(write, _WIDTH, scale)


def _grown(write: Any, width: float, scale: float) -> Panel:
    trial = _Sheet(round(width * scale), 4, scale)
    write(trial)
    sheet = _Sheet(round(width * scale), trial.y + 1, scale)
    sheet.draw.rounded_rectangle((0, 0, sheet.width - 1, trial.y), sheet.px(6), PAPER, EDGE)
    write(sheet)
    return Panel(np.array(sheet.picture), tuple(sheet.targets))


def _legend(sheet: _Sheet, state: ViewState) -> None:
    from msb.topology.verdict import judge

    model = state.model
    face = sheet.font(15, bold=True)
    title = shortened(model.name, face, sheet.width - 2 * sheet.px(_PAD))
    sheet.draw.text((sheet.px(_PAD), sheet.y), title, INK, face)
    sheet.y += sheet.px(23)
    counts = model.audit.counts
    method = f"{model.method}: " if model.method else ""
    sheet.paragraph(f"{method}{counts.vertices:,} vertices, {counts.faces:,} faces", 12, FAINT)
    verdict = judge(model.audit)
    word = {"good": "OK", "limited": "LIMITED", "bad": "BAD"}[verdict.level]
    sheet.y += sheet.px(4)
    sheet.paragraph(f"{word}: {verdict.sentence}.", 11.5)
    for note in model.notes:
        sheet.y += sheet.px(4)
        sheet.paragraph(note, 11.5, bold=True)
    sheet.y += sheet.px(6)
    for row in legend_rows(state):
        _layer_row(sheet, row)
    _component_row(sheet, state)
    sheet.y += sheet.px(4)
    _rule(sheet)
    top = sheet.y
    sheet.text(12, "H: help    N / P: next, previous    C: colours", 11.5, FAINT)
    sheet.y += sheet.px(_ROW)
    sheet.targets.append((top, sheet.y, "help"))


def _layer_row(sheet: _Sheet, row: dict[str, Any]) -> None:
    top = sheet.y
    color = INK if row["count"] else FAINT
    _check_box(sheet, on=row["on"], color=color)
    middle = (sheet.px(51), top + sheet.px(_ROW) / 2)
    symbol(sheet.draw, row["style"], middle, sheet.px(28), sheet.scale)
    sheet.text(72, row["label"], 12.5, color, bold=row["active"])
    if row["active"]:  # what N and P step through
        x, y, r = sheet.px(4), top + sheet.px(_ROW) / 2, sheet.px(5)
        sheet.draw.polygon([(x, y - r), (x, y + r), (x + r, y)], HIGHLIGHT)
    sheet.text(-28, f"{row['count']:,}", 12.5, color)
    sheet.text(-12, row["key"], 11, FAINT)
    sheet.y += sheet.px(_ROW)
    sheet.targets.append((top, sheet.y, row["kind"]))


def _component_row(sheet: _Sheet, state: ViewState) -> None:
    top = sheet.y
    on = state.coloring == "components"
    _check_box(sheet, on=on, color=INK)
    for index, (left, place) in enumerate(((38, 5), (47, 3), (56, 0))):
        high = sheet.px(14 - 3 * index)
        low = top + sheet.px(_ROW - 5)
        box = (sheet.px(left), low - high, sheet.px(left + 8), low)
        sheet.draw.rectangle(box, SIZE_CLASSES[place][2], INK)
    sheet.text(72, "Components by size", 12.5)
    sheet.text(-28, f"{len(state.model.sizes):,}", 12.5)
    sheet.text(-12, "C", 11, FAINT)
    sheet.y += sheet.px(_ROW)
    sheet.targets.append((top, sheet.y, "components"))
    for row in component_rows(state) if on else ():
        y = sheet.y + sheet.px(4)
        sheet.draw.rectangle((sheet.px(72), y, sheet.px(84), y + sheet.px(12)), row["color"], INK)
        sheet.text(92, row["label"], 11.5)
        sheet.text(-28, f"{row['count']:,}", 11.5)
        sheet.y += sheet.px(20)


def _check_box(sheet: _Sheet, *, on: bool, color: Color) -> None:
    size = sheet.px(13)
    x, y = sheet.px(13), sheet.y + (sheet.px(_ROW) - size) // 2
    sheet.draw.rectangle((x, y, x + size, y + size), (255, 255, 255), color, sheet.px(1.4))
    if on:
        path = [(x + 0.2 * size, y + 0.5 * size), (x + 0.42 * size, y + 0.75 * size)]
        path.append((x + 0.85 * size, y + 0.2 * size))
        sheet.draw.line(path, color, sheet.px(2.2))


def _rule(sheet: _Sheet) -> None:
    sheet.draw.line((sheet.px(_PAD), sheet.y, sheet.width - sheet.px(_PAD), sheet.y), EDGE)


def _help(sheet: _Sheet) -> None:
    sheet.paragraph("Keys and mouse", 15, bold=True)
    sheet.y += sheet.px(6)
    for keys, what in HELP:
        sheet.text(12, keys, 12.5, bold=True)
        sheet.text(90, what, 12.5)
        sheet.y += sheet.px(22)
    sheet.y += sheet.px(8)


def symbol(draw: Draw, style: Style, middle: tuple[float, float], width: float, scale: float) -> None:
    """Draw a layer's line and marker around `middle`, as the view draws them."""
    x, y = middle
    if style.width:
        thick = max(round(style.width * scale), 1)
        if style.line == "dashed":
            for left in (0.0, 0.4, 0.8):
                start = x - width / 2 + left * width
                draw.line((start, y, start + 0.2 * width, y), style.color, thick)
        else:
            draw.line((x - width / 2, y, x + width / 2, y), style.color, thick)
    if style.marker is not None:
        marker(draw, style, (x, y), min(max(style.size * scale / 2, 3.0), 6.5 * scale))


def marker(draw: Draw, style: Style, middle: tuple[float, float], r: float) -> None:
    """Draw a layer's marker of radius `r` with its dark rim."""
    x, y = middle
    box = (x - r, y - r, x + r, y + r)
    if style.marker == "disc":
        draw.ellipse(box, style.color, BLACK)
    elif style.marker == "diamond":
        draw.polygon([(x - r, y), (x, y - r), (x + r, y), (x, y + r)], style.color, BLACK)
    elif style.marker == "square":
        draw.rectangle(box, style.color, BLACK)
    elif style.marker == "ring":
        draw.ellipse(box, None, style.color, max(round(r / 3), 1))
    elif style.marker == "cross":
        for sign in (1, -1):
            draw.line((x - r, y - sign * r, x + r, y + sign * r), BLACK, max(round(r * 0.75), 3))
        for sign in (1, -1):
            draw.line((x - r, y - sign * r, x + r, y + sign * r), style.color, max(round(r * 0.4), 1))


def legend_width(scale: float) -> int:
    """Return the width of the legend in pixels."""
    return round(_WIDTH * scale)
