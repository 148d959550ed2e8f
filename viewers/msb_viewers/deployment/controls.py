"""Keys and mouse of the deployment viewer."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from msb_viewers.deployment.state import LAYOUTS, Layout
from msb_viewers.window import Controls

if TYPE_CHECKING:
    from msb_viewers.deployment.viewer import CompareViewer

_ARROWS, _WEST_EAST = 0, 8
"""VTK_CURSOR_DEFAULT and VTK_CURSOR_SIZEWE."""


class CompareControls(Controls["CompareViewer"]):
    """Keys and mouse as actions on a viewer, with and without a window."""

    tick = 30

    def __init__(self, viewer: CompareViewer) -> None:
        state = viewer.state
        asking: dict[str, Callable[[], object]] = {
            **{str(i): self._layout(layout) for i, layout in enumerate(LAYOUTS, 1)},
            "a": lambda: state.next_tier(0),
            "b": lambda: state.next_tier(1),
            "n": lambda: state.step(1),
            "p": lambda: state.step(-1),
            "r": state.toggle_reference,
            "g": state.next_background,
            "l": state.toggle_captions,
            "home": state.home,
        }
        keys: dict[str, Callable[[], object]] = {
            "plus": lambda: state.brighten(1),
            "equal": lambda: state.brighten(1),
            "minus": lambda: state.brighten(-1),
            "left": lambda: state.move_divider(-1),
            "right": lambda: state.move_divider(1),
            "escape": state.close_help,
        }
        super().__init__(viewer, {name: self._then_ask(action) for name, action in asking.items()} | keys)
        self.dragging = False

    def press(self, x: int, y: int) -> bool:
        """Take hold of the divider if it is at this pixel; return whether it is."""
        self.dragging = self._on_divider(x, y)
        return self.dragging

    def release(self, x: int, y: int) -> bool:
        held, self.dragging = self.dragging, False
        return held

    def move(self, x: int, y: int) -> bool:
        """Move the divider that is held to a column of the window."""
        composed = self.viewer.composition
        if self.dragging and composed is not None:
            box = composed.pictures["wipe"]
            self.viewer.state.divider = min(max((x - box.left) / box.width, 0.0), 1.0)
            self.viewer.refresh()
            return True
        self.viewer.window.SetCurrentCursor(_WEST_EAST if self._on_divider(x, y) else _ARROWS)
        return False

    def moving(self, on: bool) -> None:
        # The style would draw the window after each step of the mouse, with the picture of before.
        self.interactor.SetEnableRender(not on)
        self.viewer.moving(on)

    def turned(self) -> None:
        self.viewer.turned()
        self.ticked()

    def resized(self) -> None:
        self._ask()

    def ticked(self) -> None:
        if self.viewer.tick():
            self.viewer.refresh()

    def _on_divider(self, x: int, y: int) -> bool:
        composed = self.viewer.composition
        return composed is not None and composed.divider is not None and composed.divider.holds(x, y)

    def _layout(self, layout: Layout) -> Callable[[], object]:
        return lambda: self.viewer.state.set_layout(layout)

    def _ask(self) -> None:
        """Have the pictures drawn that the state needs now."""
        self.viewer.request()
        self.viewer.aim()

    def _then_ask(self, action: Callable[[], object]) -> Callable[[], object]:
        def done() -> None:
            if action() is not False:  # there was no view to step to
                self._ask()

        return done
