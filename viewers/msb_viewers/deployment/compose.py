"""Compose a comparison as one image: panels, captions, the divider of a wipe, the colour scale."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from msb.metrics import psnr
from msb_viewers.deployment.arrange import Box, Cell
from msb_viewers.deployment.canvas import Canvas
from msb_viewers.deployment.difference import (
    TOP,
    colorize,
    decibel_text,
    resize,
    scale_colors,
    squared_error,
)
from msb_viewers.deployment.shots import LABELS, Shot
from msb_viewers.deployment.state import CompareState
from msb_viewers.palette import INK
from msb_viewers.sheet import FAINT, text_scale

_LAYOUTS = {"side": "side by side", "wipe": "wipe", "difference": "difference"}
# Minimum width of a caption in pixels at scale 1. The caption of a narrow image may be wider than the image.
_LEAST_CAPTION = 300
# Distance between lines of a caption, in pixels at scale 1.
_LINE = 18


@dataclass(frozen=True, eq=False)
class Composition:
    """The composed image (H, W, 3), and the box of each panel in this image."""

    image: NDArray[np.uint8]
    pictures: dict[str, Box]


def compose(state: CompareState, shots: Mapping[str, Shot], size: tuple[int, int]) -> Composition:
    """Return an image of `size` pixels with the images of all tiers (shots) for one view."""
    return _Composer(state, shots, Canvas(size, text_scale(size))).draw()


def decibels(a: Shot | None, b: Shot | None) -> float | None:
    """Return the PSNR of two images in dB. If an image is missing or the sizes differ, return None."""
    if a is None or b is None or a is b or a.image is None or b.image is None:
        return None
    return psnr(a.image, b.image) if a.image.shape == b.image.shape else None


@dataclass(eq=False)
class _Composer:
    """A composed image while it is drawn."""

    state: CompareState
    shots: Mapping[str, Shot]
    canvas: Canvas

    def draw(self) -> Composition:
        """Draw all panels and the title."""
        size = next((shot.image.shape for shot in self.shots.values() if shot.image is not None), None)
        pictures = {cell.kind: self.draw_cell(cell) for cell in self.state.cells(self.canvas.size)}
        self.draw_title(size)
        return Composition(np.array(self.canvas.picture), pictures)

    def draw_cell(self, cell: Cell) -> Box:
        """Draw a panel with its caption directly below the image."""
        if cell.kind == "wipe":
            box, write = self.draw_wipe(cell.box), self.draw_pair_captions
        elif cell.kind == "difference":
            box, write = self.draw_difference(cell.box), self.draw_scale
        else:
            box = self.draw_tier(cell.kind, cell.box)
            write = partial(self.draw_caption, cell.kind)
        wide = box.width >= self.canvas.px(_LEAST_CAPTION)
        across = box if wide else cell.box
        write(Box(across.left, box.bottom, across.width, cell.caption.height))
        return box

    def draw_tier(self, tier: str, cell: Box) -> Box:
        """Draw the image of a tier, and return its box."""
        image = self.image_of(tier)
        if image is None:
            return self.draw_missing(cell, tier)
        box = cell.fitting(image.shape[1], image.shape[0])
        self.canvas.paste(resize(image, box.width, box.height), box)
        return box

    def draw_pair_captions(self, box: Box) -> None:
        """Draw the captions of A and B side by side."""
        gap = self.canvas.px(20)
        half = (box.width - gap) // 2
        for index, tier in enumerate(self.state.pair):
            self.draw_caption(tier, Box(box.left + index * (half + gap), box.top, half, box.height))

    def draw_wipe(self, cell: Box) -> Box:
        """Draw the left part of A and the right part of B with a divider between them.

        Return the box of the image.
        """
        a, b = self.state.pair
        first, second = self.image_of(a), self.image_of(b)
        if first is None or second is None:
            return self.draw_missing(cell, a if first is None else b)
        box = cell.fitting(first.shape[1], first.shape[0])
        x = box.width // 2
        picture = resize(first, box.width, box.height).copy()
        picture[:, x:] = resize(second, box.width, box.height)[:, x:]
        self.canvas.paste(picture, box)
        self.canvas.divider(box.left + x, box)
        self.canvas.chip("A", LABELS[a], box.left, box.top)
        self.canvas.chip("B", LABELS[b], box.right, box.top, from_right=True)
        return box

    def draw_difference(self, cell: Box) -> Box:
        """Draw the map of the difference of A and B. Return the box of the map."""
        a, b = self.state.pair
        first, second = self.image_of(a), self.image_of(b)
        if first is None or second is None:
            return self.draw_missing(cell, a if first is None else b)
        if first.shape != second.shape:
            return self.draw_placeholder(cell, "", "the two images have different sizes")
        box = cell.fitting(first.shape[1], first.shape[0])
        squared = resize(squared_error(first, second), box.width, box.height)
        self.canvas.paste(colorize(squared, TOP), box)
        return box

    def draw_scale(self, box: Box) -> None:
        """Draw the PSNR and the colour scale of a difference."""
        canvas, px = self.canvas, self.canvas.px
        value = decibels(*(self.shots.get(tier) for tier in self.state.pair))
        if value is None:
            return
        a, b = (LABELS[tier].lower() for tier in self.state.pair)
        y = box.top + px(18)
        width = canvas.write(box.left, y, decibel_text(value), 20, bold=True, anchor="lm")
        left = box.left + width + px(12)
        text = f"PSNR of B ({b}) with respect to A ({a}), both as 8-bit images"
        canvas.write(left, y + px(1), text, 12, FAINT, anchor="lm", room=box.right - left)
        # Draw the scale from black (0) to the brightest colour (TOP), with five labels.
        bar = Box(box.left, box.top + px(36), box.width, px(14))
        colors = scale_colors()[np.linspace(0, 255, bar.width).astype(int)]
        canvas.paste(np.repeat(colors[None], bar.height, axis=0), bar)
        canvas.draw.rectangle((bar.left, bar.top, bar.right - 1, bar.bottom - 1), None, INK)
        for index in range(5):
            x = bar.left + round((bar.width - 1) * index / 4)
            canvas.draw.line((x, bar.bottom, x, bar.bottom + px(4)), INK)
            text = f"{TOP * index / 4:g}" + (" or more" if index == 4 else "")
            canvas.write(
                x,
                bar.bottom + px(12),
                text,
                11,
                anchor=("l" if index == 0 else "r" if index == 4 else "m") + "m",
            )
        words = "difference of a pixel: root mean square of red, green and blue, from 0 to 1"
        canvas.write(box.left, bar.bottom + px(29), words, 11, FAINT, anchor="lm", room=box.width)

    def draw_caption(self, tier: str, box: Box) -> None:
        """Below the image of a tier, draw its letter, name, PSNR and times."""
        canvas, px, pair = self.canvas, self.canvas.px, self.state.pair
        x, y = float(box.left), box.top + px(14)
        if tier in pair and pair[0] != pair[1]:
            x += canvas.badge("AB"[pair.index(tier)], x, y)
        value = decibels(self.shots.get(pair[0]), self.shots.get(tier))
        room = box.right - x
        if value is not None:
            text = f"{decibel_text(value)} to A"
            room -= canvas.write(box.right, y, text, 13, bold=True, anchor="rm") + px(8)
        canvas.write(x, y, LABELS[tier], 14, bold=True, anchor="lm", room=room)
        for row, line in enumerate(caption_lines(self.shots.get(tier))):
            place = y + px(_LINE * (row + 1))
            canvas.write(box.left, place, line, 12, FAINT, anchor="lm", room=box.width)

    def draw_title(self, size: tuple[int, ...] | None) -> None:
        """Draw the name of the asset, the camera, the settings and the layout."""
        canvas, px, state = self.canvas, self.canvas.px, self.state
        scene = state.comparison
        left, right = px(12), canvas.size[0] - px(12)
        layout = _LAYOUTS[state.layout]
        room = right - left - canvas.write(right, px(16), layout, 13, bold=True, anchor="rm") - px(16)
        width = canvas.write(left, px(16), scene.name, 15, bold=True, anchor="lm", room=room)
        manifest = scene.asset.manifest
        text = f"{manifest.method}, {manifest.face_count:,} faces"
        room -= width + px(12)
        if room > px(60):
            canvas.write(left + width + px(12), px(16), text, 12, FAINT, anchor="lm", room=room)
        canvas.write(left, px(37), camera_text(state, size), 12, anchor="lm", room=right - left)
        canvas.write(left, px(56), scene.settings_text(), 12, FAINT, anchor="lm", room=right - left)

    def image_of(self, tier: str) -> NDArray[np.uint8] | None:
        shot = self.shots.get(tier)
        return None if shot is None else shot.image

    def draw_missing(self, cell: Box, tier: str) -> Box:
        """Draw the reason why a tier has no image."""
        return self.draw_placeholder(cell, "N/A", self.shots[tier].why)

    def draw_placeholder(self, cell: Box, title: str, text: str) -> Box:
        box = cell.fitting(round(1000 * self.state.aspect), 1000)
        self.canvas.placeholder(box, title, text)
        return box


def camera_text(state: CompareState, size: tuple[int, ...] | None) -> str:
    """Return the number and name of the camera as text, and the size (H, W, ...) of its images."""
    pixels = "" if size is None else f", {size[1]} x {size[0]} pixels"
    views = state.comparison.views
    return f"camera 1 of {len(views)}: {views[0].name}{pixels}"


def caption_lines(shot: Shot | None) -> list[str]:
    """Return the lines of text below an image: time, device memory, image size and device."""
    if shot is None or shot.image is None:
        return []
    parts = []
    if shot.milliseconds is not None:
        parts.append(
            f"{shot.milliseconds:.1f} ms" if shot.milliseconds < 1000 else f"{shot.milliseconds / 1000:.1f} s"
        )
    if shot.nbytes is not None:
        parts.append(f"{shot.nbytes / 1e6:.1f} MB on the device")
    height, width = shot.image.shape[:2]
    parts.append(f"{width} x {height}")
    return [", ".join(parts), shot.where]
