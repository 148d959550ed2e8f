"""The window and the controls that both viewers have: opening, camera, keys, mouse and screenshots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError
from msb_viewers import drawing
from msb_viewers.camera import Pose
from msb_viewers.gl import NO_DISPLAY
from msb_viewers.palette import BACKGROUND, unit

GAP = 12
"""Distance between panels and the window's border, in pixels at scale 1."""
_SMALLEST, _LARGEST = 0.62, 2.0
"""The least and the greatest scale of text; smaller text cannot be read."""
_FIRST = 10.0
"""Priority of our handlers; VTK's own interactor style, which uses most keys, comes later."""
_NAMES = {
    "[": "bracketleft",
    "]": "bracketright",
    "+": "plus",
    "add": "plus",
    "-": "minus",
    "subtract": "minus",
    "question": "h",
    "f1": "h",
}


class Window:
    """A window with a camera; off-screen everything but `show` works the same.

    A subclass sets `state`, with `help` and `message`, and `controls`, and draws in `refresh`.
    """

    state: Any
    controls: Any

    def __init__(self, name: str, command: str, size: tuple[int, int], *, off_screen: bool) -> None:
        import pyvista

        drawing.quiet()
        self.name, self.title, self.off_screen = name, f"{name} - msb {command}", off_screen
        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(size), lighting="none")
        self.window = self.plotter.ren_win
        if not off_screen and self.window.GetClassName() in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"):
            self.plotter.close()
            raise UsageError("VIEW_NO_DISPLAY", NO_DISPLAY)
        self.window.SetWindowName(self.title)
        self.plotter.set_background(unit(BACKGROUND))
        self.plotter.camera_set = True  # else the first picture would undo the view
        self.renderer = self.plotter.renderer
        self.camera = self.renderer.GetActiveCamera()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the window in pixels."""
        width, height = self.window.GetSize()
        return int(width), int(height)

    @property
    def scale(self) -> float:
        """The scale of all text, from the window's size."""
        return text_scale(self.size)

    @property
    def pose(self) -> Pose:
        """VTK's camera."""
        places = (self.camera.GetPosition(), self.camera.GetFocalPoint(), self.camera.GetViewUp())
        return Pose(*(np.array(place, np.float64) for place in places))

    @pose.setter
    def pose(self, pose: Pose) -> None:
        self.camera.SetPosition(*pose.eye)
        self.camera.SetFocalPoint(*pose.target)
        self.camera.SetViewUp(*pose.up)

    def refresh(self) -> None:
        """Bring the window up to date with the state, and draw."""
        raise NotImplementedError

    def image(self) -> NDArray[np.uint8]:
        """Draw and return the window (H, W, 3), row 0 at the top."""
        self.refresh()
        return np.asarray(self.plotter.screenshot(None, return_img=True), np.uint8)[..., :3]

    def screenshot(self, path: Path) -> None:
        """Write the window to a PNG."""
        write_png(self.image(), path)

    def show(self) -> None:
        """Open the window and return when it is closed."""
        self.controls.attach()
        self.refresh()
        self.plotter.show(auto_close=True, title=self.title)

    def close(self) -> None:
        """Let go of the window and of all that VTK holds. Twice is harmless."""
        self.plotter.close()


W = TypeVar("W", bound=Window)


class Controls(Generic[W]):
    """Keys and mouse as actions on a viewer. `key` also works without a window.

    Pixels are counted from the top left. A handler of the mouse returns True to keep an event from VTK, which
    else turns the view.
    """

    tick: int | None = None
    """Milliseconds between two calls of `ticked`; None: it is not called."""

    def __init__(self, viewer: W, keys: Mapping[str, Callable[[], object]]) -> None:
        self.viewer = viewer
        self.keys = {"s": self._save, "h": self.toggle_help, **keys}
        self.interactor: Any = None
        self._size = viewer.size

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

    def press(self, x: int, y: int) -> bool:
        """The left button goes down."""
        return False

    def release(self, x: int, y: int) -> bool:
        """The left button goes up, or VTK has done with a drag."""
        return False

    def move(self, x: int, y: int) -> bool:
        """The mouse moves."""
        return False

    def moving(self, on: bool) -> None:
        """VTK begins or ends to turn, move or zoom the view."""

    def turned(self) -> None:
        """VTK has turned, moved or zoomed the view."""

    def resized(self) -> None:
        """The window has another size."""

    def ticked(self) -> None:
        """Some time has passed."""

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
            ("MouseMoveEvent", lambda: self.move(*self._pixel())),
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
        if self.tick is not None:
            # While it turns the view the style alone hears of events, and without an observer of its own it
            # would turn on at each tick of the timer.
            style.AddObserver("TimerEvent", lambda *_: self._on_tick())
            self.interactor.Initialize()
            self.interactor.CreateRepeatingTimer(self.tick)

    def toggle_help(self) -> None:
        """Show the keys, or not."""
        self.viewer.state.help = not self.viewer.state.help

    def _save(self) -> None:
        path = _free_name(self.viewer.name)
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
            self.resized()
            self.viewer.refresh()
        return False

    def _on_tick(self) -> None:
        self._on_resize()
        self.ticked()


def _listen(target: Any, event: str, handler: Callable[[], bool]) -> None:
    """Call `handler` at an event of VTK; where it returns True, nobody else hears of it."""
    tag: list[int] = []

    def called(caller: Any, _name: str) -> None:
        if handler() and tag:
            caller.GetCommand(tag[0]).SetAbortFlag(1)

    tag.append(target.AddObserver(event, called, _FIRST))


def text_scale(size: tuple[int, int]) -> float:
    """Return the scale of all text in a window of `size` pixels.

    >>> text_scale((1280, 800)), text_scale((320, 200))
    (1.0, 0.62)
    """
    return float(np.clip(min(size[0] / 1280, size[1] / 800), _SMALLEST, _LARGEST))


def write_png(image: NDArray[np.uint8], path: Path) -> None:
    """Write a picture (H, W, 3)."""
    from PIL import Image

    from msb.base.atomic import new_file

    with new_file(path) as file:
        Image.fromarray(image).save(file, "PNG", optimize=True)


def _free_name(name: str) -> Path:
    """Return where a screenshot of the file called `name` goes: a name in the present folder not yet used."""
    stem = Path(name).stem or "mesh"
    number = 1
    while (path := Path(f"{stem}_view_{number}.png")).exists():
        number += 1
    return path


def key_name(name: str) -> str:
    """Return what a key is called here, whatever part of the keyboard it is on.

    >>> key_name("KP_1"), key_name("Home"), key_name("["), key_name("KP_Add")
    ('1', 'home', 'bracketleft', 'plus')
    """
    lower = name.lower().removeprefix("kp_")
    return _NAMES.get(lower, lower)
