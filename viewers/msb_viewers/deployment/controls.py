"""Keys and mouse of the deployment viewer: from VTK's events to what the state and the viewer do."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msb_viewers.deployment.state import LAYOUTS
from msb_viewers.window import event_pixel, free_name, key_name, listen

if TYPE_CHECKING:
    from msb_viewers.deployment.viewer import CompareViewer

_TICK = 30
"""Milliseconds between two looks at what has been drawn."""
_ARROWS, _WEST_EAST = 0, 8
"""VTK_CURSOR_DEFAULT and VTK_CURSOR_SIZEWE."""


class CompareControls:
    """Keys and mouse as actions on a viewer, with and without a window."""

    def __init__(self, viewer: CompareViewer) -> None:
        self.viewer = viewer
        self.dragging = False
        self._interactor: Any = None
        self._size = viewer.size
        state = viewer.state
        self.keys: dict[str, Callable[[], object]] = {
            **{str(i): self._asking(self._layout(layout)) for i, layout in enumerate(LAYOUTS, 1)},
            "a": self._asking(lambda: state.next_tier(0)),
            "b": self._asking(lambda: state.next_tier(1)),
            "n": lambda: self._step(1),
            "p": lambda: self._step(-1),
            "r": self._asking(state.toggle_reference),
            "plus": lambda: state.brighten(1),
            "equal": lambda: state.brighten(1),
            "minus": lambda: state.brighten(-1),
            "left": lambda: state.move_divider(-1),
            "right": lambda: state.move_divider(1),
            "g": self._asking(state.next_background),
            "l": self._asking(self._captions),
            "s": self._save,
            "home": self._home,
            "escape": self._escape,
            "h": self._help,
        }

    def key(self, name: str) -> bool:
        """Do what a key does; return whether it does anything."""
        name = {"add": "plus", "subtract": "minus"}.get(key_name(name), key_name(name))
        if name == "q":
            if self._interactor is not None:
                self._interactor.ExitCallback()
            return True
        action = self.keys.get(name)
        if action is None:
            return False
        action()
        self.viewer.refresh()
        return True

    def press(self, x: int, y: int) -> bool:
        """Take hold of the divider if it is at this pixel; return whether it is."""
        composed = self.viewer.composition
        self.dragging = composed is not None and composed.divider is not None and composed.divider.holds(x, y)
        return self.dragging

    def drag(self, x: int) -> None:
        """Move the divider that is held to a column of the window."""
        composed = self.viewer.composition
        if self.dragging and composed is not None:
            box = composed.pictures["wipe"]
            self.viewer.state.divider = min(max((x - box.left) / box.width, 0.0), 1.0)
            self.viewer.refresh()

    def attach(self) -> None:
        """Listen to the window's events, and look regularly at what has been drawn."""
        if self._interactor is not None:
            return
        self._interactor = self.viewer.plotter.iren.interactor
        self.viewer.plotter.enable_trackball_style()
        for event, handler in (
            ("KeyPressEvent", self._on_key),
            ("CharEvent", lambda _: True),
            ("LeftButtonPressEvent", self._on_press),
            ("LeftButtonReleaseEvent", self._on_release),
            ("MouseMoveEvent", self._on_move),
            ("ConfigureEvent", self._on_resize),
        ):
            listen(self._interactor, event, handler)
        style = self._interactor.GetInteractorStyle()
        # While it turns the view the style alone hears of events, and without an observer of its own it would
        # turn on at each tick of the timer.
        style.AddObserver("TimerEvent", lambda *_: self._on_timer())
        style.AddObserver("StartInteractionEvent", lambda *_: self._moving(True))
        style.AddObserver("InteractionEvent", lambda *_: self._turned())
        style.AddObserver("EndInteractionEvent", lambda *_: self._moving(False))
        for event in ("MouseWheelForwardEvent", "MouseWheelBackwardEvent"):
            style.AddObserver(event, lambda *_: self._turned(), -1.0)
        self._interactor.Initialize()
        self._interactor.CreateRepeatingTimer(_TICK)

    def _moving(self, on: bool) -> None:
        # The style would draw the window after each step of the mouse, with the picture of before.
        self._interactor.SetEnableRender(not on)
        self.viewer.moving(on)

    def _turned(self) -> None:
        self.viewer.turned()
        self._look()

    def _look(self) -> None:
        if self.viewer.tick():
            self.viewer.refresh()

    def _layout(self, layout: Any) -> Callable[[], object]:
        return lambda: self.viewer.state.set_layout(layout)

    def _asking(self, action: Callable[[], object]) -> Callable[[], None]:
        """Return an action after which other pictures may be needed."""

        def done() -> None:
            action()
            self.viewer.request()
            self.viewer.aim()

        return done

    def _step(self, by: int) -> None:
        if self.viewer.state.step(by):
            self.viewer.request()
            self.viewer.aim()

    def _home(self) -> None:
        self.viewer.state.home()
        self.viewer.state.message = ""
        self.viewer.request()
        self.viewer.aim()

    def _captions(self) -> None:
        self.viewer.state.captions = not self.viewer.state.captions

    def _help(self) -> None:
        self.viewer.state.help = not self.viewer.state.help

    def _escape(self) -> None:
        self.viewer.state.help = False
        self.viewer.state.message = ""

    def _save(self) -> None:
        path = free_name(self.viewer.state.comparison.name)
        self.viewer.screenshot(path)
        self.viewer.state.message = f"saved {path.name}"

    def _on_key(self, interactor: Any) -> bool:
        self.key(interactor.GetKeySym() or "")
        return True

    def _on_press(self, interactor: Any) -> bool:
        return self.press(*event_pixel(interactor, self.viewer.size[1]))

    def _on_release(self, _interactor: Any) -> bool:
        held, self.dragging = self.dragging, False
        return held

    def _on_move(self, interactor: Any) -> bool:
        x, y = event_pixel(interactor, self.viewer.size[1])
        if self.dragging:
            self.drag(x)
            return True
        divider = self.viewer.composition.divider if self.viewer.composition is not None else None
        over = divider is not None and divider.holds(x, y)
        self.viewer.window.SetCurrentCursor(_WEST_EAST if over else _ARROWS)
        return False

    def _on_resize(self, _interactor: Any) -> bool:
        if self.viewer.size != self._size:
            self._size = self.viewer.size
            self.viewer.request()
            self.viewer.aim()
            self.viewer.refresh()
        return False

    def _on_timer(self) -> None:
        self._on_resize(self._interactor)
        self._look()
