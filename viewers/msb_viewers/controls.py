"""Keys, mouse and the clipping box: from VTK's events to what the state and the viewer do."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from msb_viewers.window import CLICK, event_pixel, free_name, key_name, listen

if TYPE_CHECKING:
    from msb_viewers.viewer import TopologyViewer

_BOX = 1.02
"""First size of the clipping box, in radii of what the first view frames."""


class Controls:
    """Keys and clicks as actions on a viewer. `key` and `click` also work without a window."""

    def __init__(self, viewer: TopologyViewer) -> None:
        self.viewer = viewer
        self._pressed: tuple[int, int] | None = None
        self._last_size = viewer.size
        self._interactor: Any = None
        self._widget: Any = None
        self._attached = False
        state = viewer.state
        self.keys: dict[str, Callable[[], object]] = {
            "0": state.toggle_all,
            "tab": state.next_layer,
            "n": lambda: self._step(1),
            "p": lambda: self._step(-1),
            "f": viewer.fly_to_chosen,
            "c": state.next_coloring,
            "i": lambda: self._isolate(state.isolate_chosen),
            "bracketleft": lambda: self._isolate(lambda: state.isolate_next(-1)),
            "bracketright": lambda: self._isolate(lambda: state.isolate_next(1)),
            "k": self.toggle_box,
            "x": self._see_through,
            "l": self._legend,
            "s": self._save,
            "home": self._home,
            "r": self._home,
            "escape": self._release,
            "h": self._help,
            **{layer.style.key: self._toggler(kind) for kind, layer in state.model.layers.items()},
        }

    def key(self, name: str) -> bool:
        """Do what a key does; return whether it does anything."""
        name = key_name(name)
        if name == "q":
            self._close()
            return True
        action = self.keys.get(name)
        if action is None:
            return False
        action()
        self.viewer.refresh()
        return True

    def click(self, x: int, y: int) -> None:
        """Do what a click at a pixel does, counted from the top left: a row of the legend, or a vertex."""
        action = self.viewer.legend_hit(x, y)
        if action is None:
            self.viewer.pick(x + 0.5, y + 0.5)
            return
        if action == "help":
            self._help()
        elif action == "components":
            state = self.viewer.state
            state.coloring = "components" if state.coloring != "components" else self._plain()
        elif action in self.viewer.model.layers:
            self.viewer.state.toggle(action)
        self.viewer.refresh()

    def attach(self) -> None:
        """Listen to the window's events."""
        if self._attached:
            return
        self._attached = True
        self._interactor = self.viewer.plotter.iren.interactor
        self.viewer.plotter.enable_trackball_style()
        for event, handler in (
            ("KeyPressEvent", self._on_key),
            ("CharEvent", self._on_char),
            ("LeftButtonPressEvent", self._on_press),
            ("LeftButtonReleaseEvent", self._on_release),
            ("ConfigureEvent", self._on_resize),
            ("RenderEvent", self._on_resize),
        ):
            listen(self._interactor, event, handler)
        style = self._interactor.GetInteractorStyle()
        style.AddObserver("StartInteractionEvent", lambda *_: self.moving(True))
        style.AddObserver("EndInteractionEvent", lambda *_: self._rested())
        style.AddObserver("InteractionEvent", lambda *_: self._zoomed())
        for event in ("MouseWheelForwardEvent", "MouseWheelBackwardEvent"):
            style.AddObserver(event, lambda *_: self._zoomed(), -1.0)

    def moving(self, on: bool) -> None:
        """Draw stand-ins while the view moves, everything when it rests."""
        self.viewer.stage.moving = on
        self.viewer.stage.sync(self.viewer.state)
        self.viewer.render()

    def toggle_box(self) -> None:
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
        if self._attached:
            self._widget = viewer.plotter.add_box_widget(
                self._box_moved, bounds=box.reshape(-1).tolist(), rotation_enabled=False, color="black"
            )

    def _box_moved(self, data: Any) -> None:
        self.viewer.set_box(np.array(data.GetBounds()).reshape(3, 2))

    def _toggler(self, kind: str) -> Callable[[], object]:
        return lambda: self.viewer.state.toggle(kind)

    def _step(self, by: int) -> None:
        if self.viewer.state.step(by):
            self.viewer.fly_to_chosen()

    def _isolate(self, choose: Callable[[], object]) -> None:
        choose()
        self.viewer.fly_to_component()

    def _see_through(self) -> None:
        state = self.viewer.state
        state.through = not state.through
        state.message = "layers are seen through the surface" if state.through else "the surface hides layers"

    def _legend(self) -> None:
        self.viewer.state.legend = not self.viewer.state.legend
        self.viewer.center()

    def _save(self) -> None:
        path = free_name(self.viewer.model.name)
        self.viewer.screenshot(path)
        self.viewer.state.message = f"saved {path.name}"

    def _home(self) -> None:
        self.viewer.home()
        self.viewer.state.message = ""

    def _release(self) -> None:
        self.viewer.state.release()

    def _help(self) -> None:
        self.viewer.state.help = not self.viewer.state.help

    def _plain(self) -> Any:
        return "own" if self.viewer.model.colors is not None else "grey"

    def _close(self) -> None:
        if self._interactor is not None:
            self._interactor.ExitCallback()

    def _zoomed(self) -> None:
        viewer = self.viewer
        viewer.stage.resize(viewer.pixels_per_unit())
        viewer.fit_depth()

    def _on_key(self, interactor: Any) -> bool:
        self.key(interactor.GetKeySym() or "")
        return True

    def _on_char(self, _interactor: Any) -> bool:
        return True

    def _on_press(self, interactor: Any) -> bool:
        self._pressed = event_pixel(interactor, self.viewer.size[1])
        return self.viewer.legend_hit(*self._pressed) is not None

    def _on_release(self, _interactor: Any) -> bool:
        # Comes here only after a press on the legend: after others the style keeps the mouse to itself.
        self._clicked()
        return False

    def _rested(self) -> None:
        """End a turn or move of VTK's style; if the mouse did not move, it was a click."""
        self.moving(False)
        self._clicked()

    def _clicked(self) -> None:
        pressed, self._pressed = self._pressed, None
        if pressed is None:
            return
        x, y = event_pixel(self._interactor, self.viewer.size[1])
        if max(abs(x - pressed[0]), abs(y - pressed[1])) <= CLICK:
            self.click(x, y)

    def _on_resize(self, _interactor: Any) -> bool:
        if self.viewer.size != self._last_size:
            self._last_size = self.viewer.size
            self.viewer.center()
            self.viewer.refresh()
        return False
