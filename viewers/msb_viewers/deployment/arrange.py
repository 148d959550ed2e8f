"""Compute the position of each panel in the composed image, in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msb_viewers.deployment.state import Layout

# Heights in pixels at scale 1: a gap, the title, a caption, and the colour scale of differences.
_GAP, _HEAD, _CAPTION, _BAR = 10, 72, 64, 48
# Minimum width and height of a panel in pixels.
_LEAST = 16
# Width of the panels A and B beside their difference, as a fraction of the image width.
_THUMBNAIL = 0.3


@dataclass(frozen=True)
class Box:
    """A rectangle of pixels, counted from the top left corner.

    `right` is the first column outside the rectangle, and `bottom` is the first row outside it.
    """

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
        """Return the largest centred box with the aspect ratio `width` / `height` in this box."""
        factor = min(self.width / width, self.height / height)
        wide, high = max(round(width * factor), 1), max(round(height * factor), 1)
        return Box(self.left + (self.width - wide) // 2, self.top + (self.height - high) // 2, wide, high)


@dataclass(frozen=True)
class Cell:
    """The boxes of a panel (a tier, "wipe" or "difference") and its caption."""

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
    """Return the panel boxes of an image of `size` pixels.

    `tiers` are the tiers of the layout "side". `aspect` is the width of the images divided by their height.
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
    """Return the panel boxes of a grid.

    The number of columns is chosen so that the images are as large as possible.
    """
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
        image_height = min(box.width / aspect, box.height)
        if image_height > best[0]:
            best = image_height, cells
    return best[1]


def _cell(kind: str, box: Box, caption: int) -> Cell:
    """Return a panel. The caption fills the lower `caption` pixels of `box`."""
    high = max(box.height - caption, _LEAST)
    return Cell(
        kind,
        Box(box.left, box.top, max(box.width, _LEAST), high),
        Box(box.left, box.top + high, box.width, caption),
    )
