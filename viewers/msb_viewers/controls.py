"""Keys, clicks and the clipping box of the topology viewer."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from msb_viewers.window import Controls

if TYPE_CHECKING:
    from msb_viewers.viewer import TopologyViewer

_BOX = 1.02
"""First size of the clipping box, in radii of what the first view frames."""
_CLICK = 4
"""A click may move the mouse by at most this many pixels between press and release."""


class TopologyControls(Controls["TopologyViewer"]):
    """Keys and clicks as actions on a viewer. `key` and `click` also work without a window."""

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
        }
        super().__init__(viewer, keys | layers)
        self._pressed: tuple[int, int] | None = None
        self._widget: Any = None

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
        self._pressed = x, y
        return self.viewer.legend_hit(x, y) is not None

    def release(self, x: int, y: int) -> bool:
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
        self.viewer.stage.resize(self.viewer.pixels_per_unit())
        self.viewer.fit_depth()

    def resized(self) -> None:
        self.viewer.center()

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
