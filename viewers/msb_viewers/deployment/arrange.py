"""The place of each picture in the composed one, in boxes of whole pixels, from the layout alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msb_viewers.deployment.state import Layout

# Heights of gaps, title, captions and the scale of differences, in pixels at scale 1.
_GAP, _HEAD, _CAPTION, _BAR = 10, 72, 64, 48
# The least width and height of a picture in pixels, however small the whole is.
_LEAST = 16
# The part of the width that A and B take beside their difference.
_THUMBNAIL = 0.3


@dataclass(frozen=True)
class Box:
    """A rectangle of pixels, from the top left; `right` and `bottom` are the first pixels beyond it."""

    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        return self.left + self.width

    @property
    def bottom(self) -> int:
        return self.top + self.height

    def fitting(self, width: int, height: int) -> Box:
        """Return the largest box of this shape in the middle of it."""
        factor = min(self.width / width, self.height / height)
        wide, high = max(round(width * factor), 1), max(round(height * factor), 1)
        return Box(self.left + (self.width - wide) // 2, self.top + (self.height - high) // 2, wide, high)


@dataclass(frozen=True)
class Cell:
    """A place for a picture (a tier, "wipe" or "difference") that is fitted into it, and its caption's."""

    kind: str
    box: Box
    caption: Box


def arrange(
    layout: Layout,
    tiers: Sequence[str],
    pair: tuple[str, str],
    size: tuple[int, int],
    scale: float,
    *,
    aspect: float,
) -> list[Cell]:
    """Return the cells of a picture of `size` pixels.

    `tiers` are those that the layout "side" shows; `aspect` is width over height of the images.
    """
    gap, caption, top = round(_GAP * scale), round(_CAPTION * scale), round(_HEAD * scale)
    area = Box(gap, top, size[0] - 2 * gap, size[1] - top - gap)
    if layout == "side":
        return _grid(tiers, area, gap, caption, aspect)
    if layout == "wipe":
        return [_cell("wipe", area, caption)]
    bar = round(_BAR * scale)
    left = round(area.width * _THUMBNAIL)
    half = (area.height - gap) // 2
    return [
        _cell(
            "difference", Box(left + 2 * gap, area.top, area.width - left - gap, area.height), caption + bar
        ),
        _cell(pair[0], Box(area.left, area.top, left, half), caption),
        _cell(pair[1], Box(area.left, area.top + half + gap, left, half), caption),
    ]


def _grid(tiers: Sequence[str], area: Box, gap: int, caption: int, aspect: float) -> list[Cell]:
    """Return cells in the number of columns that makes pictures largest."""
    best: tuple[float, list[Cell]] = (-1.0, [])
    for columns in range(1, len(tiers) + 1):
        rows = -(-len(tiers) // columns)
        width = (area.width - (columns - 1) * gap) // columns
        height = (area.height - (rows - 1) * gap) // rows
        cells = [
            _cell(
                tier,
                Box(
                    area.left + (index % columns) * (width + gap),
                    area.top + (index // columns) * (height + gap),
                    width,
                    height,
                ),
                caption,
            )
            for index, tier in enumerate(tiers)
        ]
        box = cells[0].box
        worth = min(box.width / aspect, box.height)
        if worth > best[0]:
            best = worth, cells
    return best[1]


def _cell(kind: str, box: Box, caption: int) -> Cell:
    high = max(box.height - caption, _LEAST)
    return Cell(
        kind,
        Box(box.left, box.top, max(box.width, _LEAST), high),
        Box(box.left, box.top + high, box.width, caption),
    )
