"""What the window shows as one picture: panels, captions, divider, scale. It needs no VTK or display."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.metrics import psnr
from msb_viewers.deployment.arrange import Box
from msb_viewers.deployment.canvas import Canvas
from msb_viewers.deployment.difference import (
    colorize,
    decibel_text,
    fitted,
    scale_colors,
    squared_error,
)
from msb_viewers.deployment.shots import LABELS
from msb_viewers.deployment.state import HELP, LAYOUT_LABELS
from msb_viewers.palette import INK
from msb_viewers.sheet import FAINT, help_panel
from msb_viewers.window import text_scale

if TYPE_CHECKING:
    from msb_viewers.deployment.arrange import Cell
    from msb_viewers.deployment.shots import Shot
    from msb_viewers.deployment.state import CompareState

_KEPT = 32
"""The number of resized pictures and comparisons that are kept for the next composition."""
_LEAST_CAPTION = 300
"""The least width of a caption, in pixels at scale 1, if there is room below a narrower picture."""
_LINE = 18
"""Distance between lines of a caption, in pixels at scale 1."""


@dataclass(frozen=True, eq=False)
class Composition:
    """The picture (H, W, 3), where tiers, "wipe" or "difference" are in it, and what moves the wipe."""

    image: NDArray[np.uint8]
    pictures: dict[str, Box]
    divider: Box | None


class Composer:
    """Composes pictures, and keeps what the next one can use again."""

    def __init__(self) -> None:
        self._kept: dict[Any, Any] = {}

    def compose(
        self,
        state: CompareState,
        shots: Mapping[str, Shot],
        size: tuple[int, int],
        *,
        busy: Mapping[str, str] | None = None,
    ) -> Composition:
        """Return the window of `size` pixels, with what is being computed for tiers that have no shot yet."""
        return _Sheet(self, state, shots, busy or {}, Canvas(size, text_scale(size))).draw()

    def decibels(self, a: Shot | None, b: Shot | None) -> float | None:
        """Return the PSNR of two shots; None where one has no picture or they are of two sizes."""
        if a is None or b is None or a is b or a.image is None or b.image is None:
            return None
        if a.image.shape != b.image.shape:
            return None
        return float(self.once(("dB", a, b), partial(psnr, a.image, b.image)))

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return what `make` made for this key the last time, or makes now."""
        if key not in self._kept:
            while len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = make()
        return self._kept[key]


@dataclass(eq=False)
class _Sheet:
    """A composition that is being drawn."""

    composer: Composer
    state: CompareState
    shots: Mapping[str, Shot]
    busy: Mapping[str, str]
    canvas: Canvas
    divider: Box | None = field(default=None)

    def draw(self) -> Composition:
        state, canvas = self.state, self.canvas
        size = next((shot.image.shape for shot in self.shots.values() if shot.image is not None), None)
        pictures = {cell.kind: self.cell(cell) for cell in state.cells(canvas.size)}
        if state.captions:
            self.title(size)
        self.foot()
        if state.help:
            canvas.lay(help_panel(HELP, canvas.scale).image)
        return Composition(np.array(canvas.picture), pictures, self.divider)

    def cell(self, cell: Cell) -> Box:
        """Draw a cell; its caption stands close below the picture."""
        if cell.kind == "wipe":
            box, write = self.wipe(cell.box), self.pair_captions
        elif cell.kind == "difference":
            box, write = self.difference(cell.box), self.scale
        else:
            box = self.panel(cell.kind, cell.box)
            write = partial(self.caption, cell.kind)
        if self.state.captions:
            wide = box.width >= self.canvas.px(_LEAST_CAPTION)
            across = box if wide else cell.box
            write(Box(across.left, box.bottom, across.width, cell.caption.height))
        return box

    def panel(self, tier: str, cell: Box) -> Box:
        image = self.image(tier)
        if image is None:
            return self.empty(cell, *self.absence(tier))
        box = cell.fitting(image.shape[1], image.shape[0])
        self.canvas.paste(self.fitted(tier, box), box)
        return box

    def pair_captions(self, box: Box) -> None:
        gap = self.canvas.px(20)
        half = (box.width - gap) // 2
        for index, tier in enumerate(self.state.pair):
            self.caption(tier, Box(box.left + index * (half + gap), box.top, half, box.height))

    def wipe(self, cell: Box) -> Box:
        absent = [tier for tier in self.state.pair if self.image(tier) is None]
        if absent:
            return self.empty(cell, *self.absence(absent[0]))
        a, b = self.state.pair
        first = self.drawn(a)
        box = cell.fitting(first.shape[1], first.shape[0])
        x = round(self.state.divider * box.width)
        picture = self.fitted(a, box).copy()
        picture[:, x:] = self.fitted(b, box)[:, x:]
        self.canvas.paste(picture, box)
        self.canvas.divider(box.left + x, box)
        self.canvas.chip("A", LABELS[a], box.left, box.top)
        self.canvas.chip("B", LABELS[b], box.right, box.top, from_right=True)
        grip = self.canvas.px(11)
        self.divider = Box(box.left + x - grip, box.top, 2 * grip, box.height)
        return box

    def difference(self, cell: Box) -> Box:
        a, b = self.state.pair
        absent = [tier for tier in (a, b) if self.image(tier) is None]
        found = self.composer.decibels(self.shots.get(a), self.shots.get(b))
        if absent or found is None:
            title, text = self.absence(absent[0]) if absent else ("", "the two are not of one size yet")
            return self.empty(cell, title, text)
        first, second = self.drawn(a), self.drawn(b)
        key = self.shots[a], self.shots[b]
        squared = self.composer.once(("squared", *key), lambda: squared_error(first, second))
        box = cell.fitting(first.shape[1], first.shape[0])
        size = box.width, box.height
        small = self.composer.once(("shrunk", *key, size), lambda: fitted(squared, *size))
        self.canvas.paste(colorize(small, self.state.top), box)
        return box

    def scale(self, box: Box) -> None:
        """Draw the figure, and what the colours mean."""
        canvas, px, top = self.canvas, self.canvas.px, self.state.top
        found = self.composer.decibels(*(self.shots.get(tier) for tier in self.state.pair))
        if found is None:
            return
        a, b = (LABELS[tier].lower() for tier in self.state.pair)
        y = box.top + px(18)
        width = canvas.write(box.left, y, decibel_text(found), 20, bold=True, anchor="lm")
        left = box.left + width + px(12)
        text = f"PSNR of B, {b}, to A, {a}, both as 8-bit pictures"
        canvas.write(left, y + px(1), text, 12, FAINT, anchor="lm", room=box.right - left)
        bar = Box(box.left, box.top + px(36), box.width, px(14))
        colors = scale_colors()[np.linspace(0, 255, bar.width).astype(int)]
        canvas.paste(np.repeat(colors[None], bar.height, axis=0), bar)
        canvas.draw.rectangle((bar.left, bar.top, bar.right - 1, bar.bottom - 1), None, INK)
        for index in range(5):
            x = bar.left + round((bar.width - 1) * index / 4)
            canvas.draw.line((x, bar.bottom, x, bar.bottom + px(4)), INK)
            text = f"{top * index / 4:g}" + (" and more" if index == 4 and top < 1 else "")
            canvas.write(
                x,
                bar.bottom + px(12),
                text,
                11,
                anchor=("l" if index == 0 else "r" if index == 4 else "m") + "m",
            )
        words = "difference at a pixel: root mean square over red, green and blue; black to white is 1"
        canvas.write(box.left, bar.bottom + px(29), words, 11, FAINT, anchor="lm", room=box.width)

    def caption(self, tier: str, box: Box) -> None:
        canvas, px, pair = self.canvas, self.canvas.px, self.state.pair
        x, y = float(box.left), box.top + px(14)
        if tier in pair and pair[0] != pair[1]:
            x += canvas.badge("AB"[pair.index(tier)], x, y)
        found = self.composer.decibels(self.shots.get(pair[0]), self.shots.get(tier))
        room = box.right - x
        if found is not None:
            text = f"{decibel_text(found)} to A"
            room -= canvas.write(box.right, y, text, 13, bold=True, anchor="rm") + px(8)
        canvas.write(x, y, LABELS[tier], 14, bold=True, anchor="lm", room=room)
        for row, line in enumerate(caption_lines(self.shots.get(tier), self.busy.get(tier))):
            place = y + px(_LINE * (row + 1))
            canvas.write(box.left, place, line, 12, FAINT, anchor="lm", room=box.width)

    def title(self, size: tuple[int, ...] | None) -> None:
        canvas, px, state = self.canvas, self.canvas.px, self.state
        scene = state.comparison
        left, right = px(12), canvas.size[0] - px(12)
        layout = LAYOUT_LABELS[state.layout]
        room = right - left - canvas.write(right, px(16), layout, 13, bold=True, anchor="rm") - px(16)
        width = canvas.write(left, px(16), scene.name, 15, bold=True, anchor="lm", room=room)
        manifest = scene.asset.manifest
        text = f"{manifest.method}, {manifest.face_count:,} faces"
        room -= width + px(12)
        if room > px(60):
            canvas.write(left + width + px(12), px(16), text, 12, FAINT, anchor="lm", room=room)
        canvas.write(left, px(37), camera_text(state, size), 12, anchor="lm", room=right - left)
        canvas.write(left, px(56), scene.settings_text(), 12, FAINT, anchor="lm", room=right - left)

    def foot(self) -> None:
        canvas, px = self.canvas, self.canvas.px
        y = canvas.size[1] - px(15)
        hint = canvas.write(canvas.size[0] - px(12), y, "H: help", 12, FAINT, anchor="rm")
        canvas.write(px(12), y, self.state.message, 13, anchor="lm", room=canvas.size[0] - px(40) - hint)

    def empty(self, cell: Box, title: str, text: str) -> Box:
        """Write in the place of a picture why there is none."""
        aspect = self.state.aspect
        box = cell if aspect is None else cell.fitting(round(1000 * aspect), 1000)
        self.canvas.placeholder(box, title, text)
        return box

    def image(self, tier: str) -> NDArray[np.uint8] | None:
        shot = self.shots.get(tier)
        return None if shot is None else shot.image

    def drawn(self, tier: str) -> NDArray[np.uint8]:
        image = self.shots[tier].image
        assert image is not None
        return image

    def absence(self, tier: str) -> tuple[str, str]:
        """Return title and text for a tier without a picture."""
        shot = self.shots.get(tier)
        if shot is None:
            return "", self.busy.get(tier, f"{LABELS[tier].lower()}: waiting")
        return "N/A", shot.why

    def fitted(self, tier: str, box: Box) -> NDArray[np.uint8]:
        size = box.width, box.height
        key = "fitted", self.shots[tier], size
        return np.asarray(self.composer.once(key, partial(fitted, self.drawn(tier), *size)))


def camera_text(state: CompareState, size: tuple[int, ...] | None) -> str:
    """Return which camera is shown, and the size (H, W, ...) of its pictures."""
    pixels = "" if size is None else f", {size[1]} x {size[0]} pixels"
    view, count = state.view, len(state.comparison.views)
    if view is not None and state.at is not None:
        return f"camera {state.at + 1} of {count}: {view.name}{pixels}"
    return f"free camera{pixels}"


def caption_lines(shot: Shot | None, busy: str | None) -> list[str]:
    """Return what is said below a tier's picture: how long it took, what it holds, and where."""
    if shot is None or shot.image is None:
        return [busy] if busy else []
    parts = []
    if shot.milliseconds is not None:
        parts.append(
            f"{shot.milliseconds:.1f} ms" if shot.milliseconds < 1000 else f"{shot.milliseconds / 1000:.1f} s"
        )
    if shot.nbytes is not None:
        parts.append(f"{shot.nbytes / 1e6:.1f} MB on the device")
    height, width = shot.image.shape[:2]
    parts.append(f"{width} x {height}")
    return [", ".join(parts), busy or shot.where]
