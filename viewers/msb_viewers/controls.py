"""Keys, clicks and the clipping box of the topology viewer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from msb_viewers.viewer import TopologyViewer

# First size of the clipping box, in radii of what the first view frames.
_BOX = 1.02
# A click may move the mouse by at most this many pixels between press and release.
_CLICK = 4
# Priority of our handlers; VTK's own interactor style, which uses most keys, comes later.
_FIRST = 10.0
_NAMES = {
    "[": "bracketleft",
    "]": "bracketright",
    "question": "h",
    "f1": "h",
}


class TopologyControls:
    """Keys and mouse as actions on a viewer. `key` and `click` also work without a window.

    Pixels are counted from the top left.
    """

    def __init__(self, viewer: TopologyViewer) -> None:
        state = viewer.state
        layers = {layer.style.key: self._toggler(kind) for kind, layer in state.model.layers.items()}
        keys: dict[str, Callable[[], object]] = {
            "0": state.toggle_all,
            "tab": state.next_layer,
            "n": lambda: self._step(1),
            "p": lambda: self._step(-1),
            "f": viewer.fly_to_chosen,
            "c": state.next_coloring,
            "i": lambda: self._isolate(state.isolate_chosen),
            "bracketleft": lambda: self._isolate(lambda: state.isolate_next(-1)),
            "bracketright": lambda: self._isolate(lambda: state.isolate_next(1)),
            "k": self._toggle_box,
            "x": state.toggle_through,
            "l": self._toggle_legend,
            "home": self._home,
            "r": self._home,
            "escape": state.release,
            "s": self._save,
            "h": self.toggle_help,
        }
        self.viewer = viewer
        self.keys = keys | layers
        self.interactor: Any = None
        self._size = viewer.size
        self._pressed: tuple[int, int] | None = None
        self._widget: Any = None

    def key(self, name: str) -> bool:
        """Do what a key does; return whether it does anything."""
        name = key_name(name)
        if name == "q":
            if self.interactor is not None:
                self.interactor.ExitCallback()
            return True
        action = self.keys.get(name)
        if action is None:
            return False
        action()
        self.viewer.refresh()
        return True

    def click(self, x: int, y: int) -> None:
        """Do what a click at a pixel does: on a row of the legend, or on a vertex."""
        action = self.viewer.legend_hit(x, y)
        if action is None:
            self.viewer.pick(x + 0.5, y + 0.5)
            return
        if action == "help":
            self.toggle_help()
        elif action == "components":
            self.viewer.state.toggle_components()
        elif action in self.viewer.model.layers:
            self.viewer.state.toggle(action)
        self.viewer.refresh()

    def press(self, x: int, y: int) -> bool:
        """Remember where the left button goes down; return whether that is on the legend."""
        self._pressed = x, y
        return self.viewer.legend_hit(x, y) is not None

    def release(self, x: int, y: int) -> bool:
        """Click, unless the mouse was dragged."""
        pressed, self._pressed = self._pressed, None
        if pressed is not None and max(abs(x - pressed[0]), abs(y - pressed[1])) <= _CLICK:
            self.click(x, y)
        return False

    def moving(self, on: bool) -> None:
        """Draw stand-ins while the view moves, everything when it rests."""
        self.viewer.stage.moving = on
        self.viewer.stage.sync(self.viewer.state)
        self.viewer.render()

    def turned(self) -> None:
        """Fit sizes and depth to the view that VTK has turned, moved or zoomed."""
        self.viewer.stage.resize(self.viewer.pixels_per_unit())
        self.viewer.fit_depth()

    def attach(self) -> None:
        """Listen to the window's events."""
        if self.interactor is not None:
            return
        self.interactor = self.viewer.plotter.iren.interactor
        self.viewer.plotter.enable_trackball_style()
        for event, handler in (
            ("KeyPressEvent", self._on_key),
            ("CharEvent", lambda: True),
            ("LeftButtonPressEvent", lambda: self.press(*self._pixel())),
            ("LeftButtonReleaseEvent", lambda: self.release(*self._pixel())),
            ("ConfigureEvent", self._on_resize),
            ("RenderEvent", self._on_resize),
        ):
            _listen(self.interactor, event, handler)
        style = self.interactor.GetInteractorStyle()
        style.AddObserver("StartInteractionEvent", lambda *_: self.moving(True))
        style.AddObserver("InteractionEvent", lambda *_: self.turned())
        style.AddObserver("EndInteractionEvent", lambda *_: self._on_rest())
        for event in ("MouseWheelForwardEvent", "MouseWheelBackwardEvent"):
            style.AddObserver(event, lambda *_: self.turned(), -1.0)

    def toggle_help(self) -> None:
        """Show the keys, or not."""
        self.viewer.state.help = not self.viewer.state.help

    def _save(self) -> None:
        path = _free_name(self.viewer.model.name)
        self.viewer.screenshot(path)
        self.viewer.state.message = f"saved {path.name}"

    def _pixel(self) -> tuple[int, int]:
        x, y = self.interactor.GetEventPosition()
        return int(x), self.viewer.size[1] - 1 - int(y)

    def _on_key(self) -> bool:
        self.key(self.interactor.GetKeySym() or "")
        return True

    def _on_rest(self) -> None:
        self.moving(False)
        self.release(*self._pixel())

    def _on_resize(self) -> bool:
        if self.viewer.size != self._size:
            self._size = self.viewer.size
            self.viewer.center()
            self.viewer.refresh()
        return False

    def _toggle_box(self) -> None:
        """Switch the clipping box; on a window it has handles to drag."""
        viewer = self.viewer
        if viewer.stage.box is not None:
            viewer.set_box(None)
            if self._widget is not None:
                self._widget.Off()
                self._widget = None
            viewer.state.message = "clipping box: off"
            return
        box = np.array([[-_BOX, _BOX]] * 3)
        viewer.set_box(box)
        viewer.state.message = "clipping box: drag the handles of its sides; K: off"
        if self.interactor is not None:
            self._widget = viewer.plotter.add_box_widget(
                lambda data: viewer.set_box(np.array(data.GetBounds()).reshape(3, 2)),
                bounds=box.reshape(-1).tolist(),
                rotation_enabled=False,
                color="black",
            )

    def _toggler(self, kind: str) -> Callable[[], object]:
        return lambda: self.viewer.state.toggle(kind)

    def _step(self, by: int) -> None:
        if self.viewer.state.step(by):
            self.viewer.fly_to_chosen()

    def _isolate(self, choose: Callable[[], object]) -> None:
        choose()
        self.viewer.fly_to_component()

    def _toggle_legend(self) -> None:
        self.viewer.state.legend = not self.viewer.state.legend
        self.viewer.center()

    def _home(self) -> None:
        self.viewer.home()
        self.viewer.state.message = ""


def _listen(target: Any, event: str, handler: Callable[[], bool]) -> None:
    """Call `handler` at an event of VTK; where it returns True, nobody else hears of it."""
    tag: list[int] = []

    def called(caller: Any, _name: str) -> None:
        if handler() and tag:
            caller.GetCommand(tag[0]).SetAbortFlag(1)

    tag.append(target.AddObserver(event, called, _FIRST))


def _free_name(name: str) -> Path:
    """Return where a screenshot of the file called `name` goes: a name in the present folder not yet used."""
    stem = Path(name).stem or "mesh"
    number = 1
    while (path := Path(f"{stem}_view_{number}.png")).exists():
        number += 1
    return path


def key_name(name: str) -> str:
    """Return what a key is called here, whatever part of the keyboard it is on.

    >>> key_name("KP_1"), key_name("Home"), key_name("[")
    ('1', 'home', 'bracketleft')
    """
    lower = name.lower().removeprefix("kp_")
    return _NAMES.get(lower, lower)
