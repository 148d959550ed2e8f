"""The legend of the topology viewer as an image, with the action of each row."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb_viewers.palette import BLACK, HIGHLIGHT, INK, NEUTRAL, SIZE_CLASSES, Color, Style, size_label
from msb_viewers.sheet import EDGE, FAINT, LEGEND_WIDTH, PAD, ROW, Panel, Sheet, draw_panel, shorten_text

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw as Draw

    from msb_viewers.state import ViewState


def legend_panel(state: ViewState, scale: float = 1.0) -> Panel:
    """Return the legend: counts, verdict, and one row for each layer.

    A row of the legend has a check box, a number and a key.
    """
    return draw_panel(lambda sheet: _legend(sheet, state), LEGEND_WIDTH, scale)


def _legend(sheet: Sheet, state: ViewState) -> None:
    from msb.topology.verdict import judge

    model = state.model
    face = sheet.font(15, bold=True)
    title = shorten_text(model.name, face, sheet.width - 2 * sheet.px(PAD))
    sheet.draw.text((sheet.px(PAD), sheet.y), title, INK, face)
    sheet.y += sheet.px(23)
    counts = model.audit.judged.counts
    method = f"{model.method}: " if model.method else ""
    sheet.paragraph(f"{method}{counts.vertices:,} vertices, {counts.faces:,} faces", 12, FAINT)
    sheet.y += sheet.px(4)
    sheet.paragraph(str(judge(model.audit)), 11.5)
    for note in model.notes:
        sheet.y += sheet.px(4)
        sheet.paragraph(note, 11.5, bold=True)
    sheet.y += sheet.px(6)
    for kind in model.layers:
        _layer_row(sheet, state, kind)
    _component_row(sheet, state)
    sheet.y += sheet.px(4)
    sheet.draw.line((sheet.px(PAD), sheet.y, sheet.width - sheet.px(PAD), sheet.y), EDGE)
    top = sheet.y
    sheet.text(12, "H: help    N / P: next, previous    C: colours", 11.5, FAINT)
    sheet.y += sheet.px(ROW)
    sheet.targets.append((top, sheet.y, "help"))


def _layer_row(sheet: Sheet, state: ViewState, kind: str) -> None:
    layer = state.model.layers[kind]
    top, style, count = sheet.y, layer.style, len(layer)
    active = kind == state.active and count > 0
    color = INK if count else FAINT
    _check_box(sheet, on=kind in state.visible, color=color)
    middle = (sheet.px(51), top + sheet.px(ROW) / 2)
    draw_symbol(sheet.draw, style, middle, sheet.px(28), sheet.scale)
    sheet.text(72, style.label, 12.5, color, bold=active)
    if active:  # mark the active layer, whose elements are selected by the keys N and P
        x, y, r = sheet.px(4), top + sheet.px(ROW) / 2, sheet.px(5)
        sheet.draw.polygon([(x, y - r), (x, y + r), (x + r, y)], HIGHLIGHT)
    sheet.text(-28, f"{count:,}", 12.5, color)
    sheet.text(-12, style.key, 11, FAINT)
    sheet.y += sheet.px(ROW)
    sheet.targets.append((top, sheet.y, kind))


def _component_row(sheet: Sheet, state: ViewState) -> None:
    top = sheet.y
    on = state.coloring == "components"
    _check_box(sheet, on=on, color=INK)
    for index, (left, place) in enumerate(((38, 5), (47, 3), (56, 0))):
        high = sheet.px(14 - 3 * index)
        low = top + sheet.px(ROW - 5)
        box = (sheet.px(left), low - high, sheet.px(left + 8), low)
        sheet.draw.rectangle(box, SIZE_CLASSES[place][2], INK)
    sheet.text(72, "Components by size", 12.5)
    sheet.text(-28, f"{len(state.model.sizes):,}", 12.5)
    sheet.text(-12, "C", 11, FAINT)
    sheet.y += sheet.px(ROW)
    sheet.targets.append((top, sheet.y, "components"))
    if not on or not len(state.model.sizes):
        return
    # Draw one row for each size class, beginning with the largest component.
    rows = [(NEUTRAL, f"largest: {int(state.model.sizes[0]):,} faces", 1)]
    rows += [(c.color, size_label(c.low, c.high), c.components) for c in reversed(state.model.size_classes())]
    for color, label, count in rows:
        y = sheet.y + sheet.px(4)
        sheet.draw.rectangle((sheet.px(72), y, sheet.px(84), y + sheet.px(12)), color, INK)
        sheet.text(92, label, 11.5)
        sheet.text(-28, f"{count:,}", 11.5)
        sheet.y += sheet.px(20)


def _check_box(sheet: Sheet, *, on: bool, color: Color) -> None:
    size = sheet.px(13)
    x, y = sheet.px(13), sheet.y + (sheet.px(ROW) - size) // 2
    sheet.draw.rectangle((x, y, x + size, y + size), (255, 255, 255), color, sheet.px(1.4))
    if on:
        path = [(x + 0.2 * size, y + 0.5 * size), (x + 0.42 * size, y + 0.75 * size)]
        path.append((x + 0.85 * size, y + 0.2 * size))
        sheet.draw.line(path, color, sheet.px(2.2))


def draw_symbol(draw: Draw, style: Style, middle: tuple[float, float], width: float, scale: float) -> None:
    """Draw the line and marker of a layer at `middle`, as in the view."""
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
        draw_marker(draw, style, (x, y), min(max(style.size * scale / 2, 3.0), 6.5 * scale))


def draw_marker(draw: Draw, style: Style, middle: tuple[float, float], r: float) -> None:
    """Draw the marker of a layer with radius `r` and a dark rim."""
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
