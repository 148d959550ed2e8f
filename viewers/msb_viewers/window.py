"""What every viewer's window has: how it opens, hears of events, names its screenshots and writes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError
from msb_viewers import drawing
from msb_viewers.gl import NO_DISPLAY
from msb_viewers.palette import BACKGROUND, unit

GAP = 12
"""Distance between panels and the window's border, in pixels at scale 1."""
CLICK = 4
"""A click may move the mouse by at most this many pixels between press and release."""
_SMALLEST, _LARGEST = 0.62, 2.0
"""The least and the greatest scale of text; smaller text cannot be read."""
_FIRST = 10.0
"""Priority of our handlers; VTK's own interactor style, which uses most keys, comes later."""
_NAMES = {"[": "bracketleft", "]": "bracketright", "+": "plus", "-": "minus", "question": "h", "f1": "h"}


def open_plotter(title: str, size: tuple[int, int], *, off_screen: bool) -> Any:
    """Return a pyvista plotter on a window called `title`, or off-screen."""
    import pyvista

    drawing.quiet()
    plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(size), lighting="none")
    window = plotter.ren_win
    if not off_screen and window.GetClassName() in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"):
        plotter.close()
        raise UsageError("VIEW_NO_DISPLAY", NO_DISPLAY)
    window.SetWindowName(title)
    plotter.set_background(unit(BACKGROUND))
    plotter.camera_set = True  # else the first picture would undo the view
    return plotter


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


def free_name(name: str) -> Path:
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
    lower = name.lower()
    return _NAMES.get(lower, lower).removeprefix("kp_")


def listen(target: Any, event: str, handler: Callable[[Any], bool]) -> None:
    """Call `handler` at an event of VTK; where it returns True, nobody else hears of it."""
    tag: list[int] = []

    def called(caller: Any, _name: str) -> None:
        if handler(caller) and tag:
            caller.GetCommand(tag[0]).SetAbortFlag(1)

    tag.append(target.AddObserver(event, called, _FIRST))


def event_pixel(interactor: Any, height: int) -> tuple[int, int]:
    """Return the pixel of the latest event, from the top left of a window `height` pixels high."""
    x, y = interactor.GetEventPosition()
    return int(x), height - 1 - int(y)
