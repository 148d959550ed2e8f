"""A window with a camera: opening, closing and screenshots."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError
from msb_viewers import drawing
from msb_viewers.camera import Pose
from msb_viewers.gl import NO_DISPLAY
from msb_viewers.palette import BACKGROUND, unit
from msb_viewers.sheet import text_scale, write_png

# Distance between panels and the window's border, in pixels at scale 1.
GAP = 12


class Window:
    """A window with a camera; off-screen everything but `show` works the same.

    A subclass sets `state`, with `help` and `message`, and `controls`, and draws in `refresh`.
    """

    state: Any
    controls: Any

    def __init__(self, name: str, size: tuple[int, int], *, off_screen: bool) -> None:
        import pyvista

        drawing.quiet()
        self.name, self.title, self.off_screen = name, f"{name} - msb view", off_screen
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
