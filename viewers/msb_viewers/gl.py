"""Check in a child process whether VTK can draw. If OpenGL is missing, VTK ends the process."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass

from msb.base.extras import need_extra
from msb.errors import UsageError

# Program of the child process: it draws 8 x 8 pixels and reads the pixels back.
PROBE = """
from vtkmodules.vtkCommonCore import vtkLogger, vtkObject
vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
vtkObject.GlobalWarningDisplayOff()
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter
window, renderer = vtkRenderWindow(), vtkRenderer()
window.SetOffScreenRendering(1)
window.SetSize(8, 8)
renderer.SetBackground(1, 0, 1)
window.AddRenderer(renderer)
window.Render()
picture = vtkWindowToImageFilter()
picture.SetInput(window)
picture.Update()
pixels = picture.GetOutput().GetPointData().GetScalars()
print("drawn" if pixels.GetTuple3(0) == (255.0, 0.0, 255.0) else "black")
"""
NO_GL = (
    "VTK cannot draw: this machine has no display, no EGL and no OSMesa. Install EGL or OSMesa: on Debian "
    "and "
    "Ubuntu apt install libegl1 libgl1-mesa-dri (or libosmesa6), on Fedora dnf install mesa-libEGL "
    "mesa-dri-drivers, without root conda install -c conda-forge mesalib. --html needs no OpenGL"
)
NO_DISPLAY = (
    "a window needs a display; without one use msb view --screenshot FILE.png or msb view --html FILE.html"
)
# Time limit of the test in seconds. On a busy machine, software OpenGL needs a few seconds. A graphics driver
# can also stop responding.
_SECONDS = 60


@dataclass
class GlProbe:
    """A test of VTK in a child process, which runs until `check` is called."""

    process: subprocess.Popen[str] | None

    @classmethod
    def start(cls) -> GlProbe:
        """Start the test of VTK."""
        need_extra("view", "pyvista", "vtkmodules", what="the viewer", instead="--html works without it")
        if sys.platform in ("win32", "darwin"):
            return cls(None)  # Windows and macOS contain OpenGL
        command = [sys.executable, "-c", PROBE]
        quiet = subprocess.DEVNULL
        return cls(subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet, text=True))

    def check(self) -> None:
        """Wait for the result, and raise VIEW_NO_DISPLAY if VTK cannot draw."""
        if self.process is None:
            return
        try:
            answer, _ = self.process.communicate(timeout=_SECONDS)
        except subprocess.TimeoutExpired:
            answer = ""
        finally:
            self.close()
        if "drawn" not in answer:
            raise UsageError("VIEW_NO_DISPLAY", NO_GL)

    def close(self) -> None:
        """Kill the child process if it still runs."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if self.process is not None and self.process.stdout is not None:
            self.process.stdout.close()


def check_display() -> None:
    """Check that a window has a display. If no display exists, raise VIEW_NO_DISPLAY."""
    if sys.platform in ("win32", "darwin"):
        return
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UsageError("VIEW_NO_DISPLAY", NO_DISPLAY)
