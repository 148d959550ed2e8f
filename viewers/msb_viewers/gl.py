"""Whether VTK can draw. A child process finds out, because without a GL stack VTK ends the process."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass

from msb.base.extras import need_extra
from msb.errors import UsageError

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
    "VTK found no way to draw: neither a display, nor EGL, nor OSMesa. Install one of them: on Debian and "
    "Ubuntu apt install libegl1 libgl1-mesa-dri (or libosmesa6), on Fedora dnf install mesa-libEGL "
    "mesa-dri-drivers, without root conda install -c conda-forge mesalib. --html needs none of this"
)
NO_DISPLAY = (
    "there is no display to open a window on; msb view draws without one, given --screenshot FILE.png or "
    "--html FILE.html"
)
# Seconds to wait. A software GL on a loaded machine takes a few; a hanging driver must not hang us.
_SECONDS = 60


@dataclass
class GlProbe:
    """A question to a child process; other work can go on until `check` is called."""

    process: subprocess.Popen[str] | None

    @classmethod
    def start(cls) -> GlProbe:
        """Ask whether VTK can draw."""
        need_extra("view", "pyvista", "vtkmodules", what="the viewer", instead="pages (--html) need none")
        if sys.platform in ("win32", "darwin"):
            return cls(None)  # both bring a GL stack
        command = [sys.executable, "-c", PROBE]
        quiet = subprocess.DEVNULL
        return cls(subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet, text=True))

    def check(self) -> None:
        """Wait for the answer."""
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
        """End the child if it still runs."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if self.process is not None and self.process.stdout is not None:
            self.process.stdout.close()


def check_display() -> None:
    """Refuse to open a window where there is nothing to open it on."""
    if sys.platform in ("win32", "darwin"):
        return
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UsageError("VIEW_NO_DISPLAY", NO_DISPLAY)
