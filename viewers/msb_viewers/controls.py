"""Keyboard, mouse and clipping box of the topology viewer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from msb_viewers.viewer import TopologyViewer

# Half-width of a new clipping box. The unit is the radius of the sphere that the first view shows.
_BOX = 1.02
# Maximum distance in pixels between the press and the release of the mouse button in a click.
_CLICK = 4
# Priority of the event handlers below. These event handlers must run before the handlers of VTK's interactor
# style, because that style also uses most keys.
_FIRST = 10.0
# Names of VTK or X11 keys. The values are the names of the same keys in `TopologyControls.keys`.
_NAMES = {
    "[": "bracketleft",
    "]": "bracketright",
    "question": "h",
    "f1": "h",
}


class TopologyControls:
    """Keyboard and mouse actions on a viewer. `key` and `click` also work without a window.

    Pixel coordinates start at the top left corner.
    """

    def __init__(self, viewer: TopologyViewer) -> None:
        state = viewer.state
        layers = {layer.style.key: self._toggler(kind) for kind, layer in state.model.layers.items()}
        keys: dict[str, Callable[[], object]] = {
            "0": state.toggle_all,
            "tab": state.next_layer,
            "n": lambda: self._step(1),
            "p": lambda: self._step(-1),
            "f": viewer.fly_to_selection,
            "c": state.next_coloring,
            "i": lambda: self._isolate(state.isolate_selection),
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
        """Perform the action of a key. Return whether the key has an action."""
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
        """Perform the action of a click at a pixel: on a row of the legend, or on a vertex."""
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
        """Store the pixel where the left button is pressed. Return whether this pixel is on the legend."""
        self._pressed = x, y
        return self.viewer.legend_hit(x, y) is not None

    def release(self, x: int, y: int) -> bool:
        """If the mouse was not dragged, perform a click."""
        pressed, self._pressed = self._pressed, None
        if pressed is not None and max(abs(x - pressed[0]), abs(y - pressed[1])) <= _CLICK:
            self.click(x, y)
        return False

    def set_moving(self, on: bool) -> None:
        """While the view moves, draw simplified meshes; when it stops, draw everything."""
        self.viewer.stage.moving = on
        self.viewer.stage.sync(self.viewer.state)
        self.viewer.render()

    def adapt_view(self) -> None:
        """Adapt sizes and depth range after VTK has rotated, moved or zoomed the view."""
        self.viewer.stage.resize(self.viewer.pixels_per_unit())
        self.viewer.fit_depth()

    def attach(self) -> None:
        """Handle the events of the window."""
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
        style.AddObserver("StartInteractionEvent", lambda *_: self.set_moving(True))
        style.AddObserver("InteractionEvent", lambda *_: self.adapt_view())
        style.AddObserver("EndInteractionEvent", lambda *_: self._on_rest())
        for event in ("MouseWheelForwardEvent", "MouseWheelBackwardEvent"):
            style.AddObserver(event, lambda *_: self.adapt_view(), -1.0)

    def toggle_help(self) -> None:
        """Show or hide the list of keys."""
        self.viewer.state.help = not self.viewer.state.help

    def _save(self) -> None:
        path = _free_name(self.viewer.model.name)
        self.viewer.screenshot(path)
        self.viewer.state.message = f"Saved {path.name}"

    def _pixel(self) -> tuple[int, int]:
        x, y = self.interactor.GetEventPosition()
        return int(x), self.viewer.size[1] - 1 - int(y)

    def _on_key(self) -> bool:
        self.key(self.interactor.GetKeySym() or "")
        return True

    def _on_rest(self) -> None:
        self.set_moving(False)
        self.release(*self._pixel())

    def _on_resize(self) -> bool:
        if self.viewer.size != self._size:
            self._size = self.viewer.size
            self.viewer.center()
            self.viewer.refresh()
        return False

    def _toggle_box(self) -> None:
        """Switch the clipping box on or off.

        In a window, the clipping box has handles that the user can drag.
        """
        viewer = self.viewer
        if viewer.stage.box is not None:
            viewer.set_box(None)
            if self._widget is not None:
                self._widget.Off()
                self._widget = None
            viewer.state.message = "Clipping box: off"
            return
        box = np.array([[-_BOX, _BOX]] * 3)
        viewer.set_box(box)
        viewer.state.message = "Clipping box: drag the handles on its sides; K: off"
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
            self.viewer.fly_to_selection()

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
    """Call `handler` for an event of VTK. If the handler returns True, no other handler is called."""
    tag: list[int] = []

    def handle(caller: Any, _name: str) -> None:
        if handler() and tag:
            caller.GetCommand(tag[0]).SetAbortFlag(1)

    tag.append(target.AddObserver(event, handle, _FIRST))


def _free_name(name: str) -> Path:
    """Return an unused file name in the current folder for a screenshot. The file name begins with `name`."""
    stem = Path(name).stem or "mesh"
    number = 1
    while (path := Path(f"{stem}_view_{number}.png")).exists():
        number += 1
    return path


def key_name(name: str) -> str:
    """Return the name of a key in `TopologyControls.keys`. Keys of the numeric keypad are also accepted.

    >>> key_name("KP_1"), key_name("Home"), key_name("[")
    ('1', 'home', 'bracketleft')
    """
    lower = name.lower().removeprefix("kp_")
    return _NAMES.get(lower, lower)
