"""The canvas of the composed image, with functions to draw images, text, labels and the divider of a wipe."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers.deployment.arrange import Box
from msb_viewers.palette import BACKGROUND, INK, WHITE, Color
from msb_viewers.sheet import FAINT, font, shorten_text, wrap_text

_EMPTY: Color = (226, 227, 229)
_BADGE: Color = (60, 64, 72)


class Canvas:
    """An image to draw on. Lengths and font sizes are in pixels at scale 1."""

    def __init__(self, size: tuple[int, int], scale: float) -> None:
        from PIL import Image, ImageDraw

        self.size, self.scale = size, scale
        self.picture = Image.new("RGB", size, BACKGROUND)
        self.draw: Any = ImageDraw.Draw(self.picture)

    def px(self, value: float) -> int:
        """Return a length in pixels. The result is at least one pixel."""
        return max(round(value * self.scale), 1)

    def font(self, size: float, *, bold: bool = False) -> Any:
        """Return the font of a size."""
        return font(max(round(size * self.scale), 7), bold=bold)

    def write(
        self,
        x: float,
        y: float,
        text: str,
        size: float = 12,
        color: Color = INK,
        *,
        bold: bool = False,
        anchor: str = "la",
        room: float | None = None,
    ) -> float:
        """Write a line of text and return its width.

        A line that is wider than `room` is shortened in the middle.
        """
        face = self.font(size, bold=bold)
        line = text if room is None else shorten_text(text, face, max(room, 1))
        self.draw.text((x, y), line, color, face, anchor=anchor)
        return float(face.getlength(line))

    def paste(self, image: NDArray[np.uint8], box: Box) -> None:
        """Draw an image (H, W, 3) at the upper left corner of `box`."""
        from PIL import Image

        self.picture.paste(Image.fromarray(np.ascontiguousarray(image)), (box.left, box.top))

    def placeholder(self, box: Box, title: str, text: str) -> None:
        """Fill a box without an image, and write the reason into it."""
        self.draw.rectangle((box.left, box.top, box.right - 1, box.bottom - 1), _EMPTY)
        face, high = self.font(13), self.px(18)
        lines = wrap_text(text, face, max(box.width - 2 * self.px(16), 1))
        x = box.left + box.width / 2
        y = box.top + (box.height - high * len(lines)) / 2
        if title:
            self.write(x, y - self.px(16), title, 18, bold=True, anchor="mm")
            y += self.px(8)
        for index, line in enumerate(lines):
            self.write(x, y + high * (index + 0.5), line, 13, anchor="mm")

    def badge(self, letter: str, x: float, y: float) -> float:
        """Draw a letter on a dark square with its left side at `x`.

        Return the width of the square with its margin.
        """
        half = self.px(9)
        self.draw.rounded_rectangle((x, y - half, x + 2 * half, y + half), self.px(3), _BADGE)
        self.write(x + half, y, letter, 13, WHITE, bold=True, anchor="mm")
        return 2 * half + self.px(6)

    def chip(self, letter: str, text: str, x: float, y: float, *, from_right: bool = False) -> None:
        """Draw a label with a letter and a text in the upper left or right corner of an image."""
        face = self.font(13, bold=True)
        width, high = face.getlength(text) + self.px(34), self.px(26)
        left = x - width - self.px(6) if from_right else x + self.px(6)
        top = y + self.px(6)
        self.draw.rounded_rectangle((left, top, left + width, top + high), self.px(4), WHITE, FAINT)
        after = self.badge(letter, left + self.px(4), top + high / 2)
        self.write(left + self.px(4) + after, top + high / 2, text, 13, bold=True, anchor="lm")

    def divider(self, x: float, box: Box) -> None:
        """Draw the divider of a wipe over an image, with a handle in the middle."""
        self.draw.line((x, box.top, x, box.bottom - 1), INK, self.px(3))
        self.draw.line((x, box.top, x, box.bottom - 1), WHITE, self.px(1))
        y, r = box.top + box.height / 2, self.px(11)
        self.draw.ellipse((x - r, y - r, x + r, y + r), WHITE, INK, self.px(1.5))
        for sign in (-1, 1):
            tip, back = x + sign * 0.72 * r, x + sign * 0.22 * r
            self.draw.polygon([(tip, y), (back, y - 0.42 * r), (back, y + 0.42 * r)], INK)
