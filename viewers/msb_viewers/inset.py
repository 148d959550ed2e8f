"""The fan inspector: the fans at a vertex drawn apart, in a corner of the window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers import drawing
from msb_viewers.fanout import neighbourhood
from msb_viewers.palette import FAN_COLORS, INK, STYLES
from msb_viewers.sheet import Panel, list_panel

if TYPE_CHECKING:
    from msb_viewers.fanout import Fan, Neighbourhood
    from msb_viewers.model import ViewModel


_MOST_LINES = 8
"""The most lines of text; the drawing shows the other fans, too."""


class Inset:
    """A renderer of its own in the lower right corner, and the text above it."""

    def __init__(self, window: Any, layer: int) -> None:
        from vtkmodules.vtkRenderingCore import vtkRenderer

        self.renderer = vtkRenderer()
        self.renderer.SetLayer(layer)
        self.renderer.InteractiveOff()
        self.renderer.DrawOff()
        window.AddRenderer(self.renderer)
        self.shown: Neighbourhood | None = None
        self.panel: Panel | None = None

    def show(self, model: ViewModel, vertex: int | None, scale: float) -> str:
        """Show the fans of a vertex, or nothing; return what to say of it."""
        self.renderer.RemoveAllViewProps()
        self.renderer.SetDraw(vertex is not None)
        if vertex is None:
            self.shown = self.panel = None
            return ""
        self.shown = neighbourhood(model, vertex)
        for fan in self.shown.fans:
            for actor in fan_actors(fan):
                self.renderer.AddActor(actor)
            self.renderer.AddViewProp(number_label(fan, scale))
        self._look(self.shown)
        lines: list[Any] = [
            (text, FAN_COLORS[index % len(FAN_COLORS)] if index < len(self.shown.fans) else None)
            for index, text in enumerate(self.shown.lines())
        ]
        self.panel = list_panel(f"Vertex {vertex:,}", self.shown.verdict, lines[:_MOST_LINES], scale)
        return f"vertex {vertex}: {self.shown.verdict}"

    def place(self, left: float, bottom: float, right: float, top: float) -> None:
        """Put the drawing where the window's fractions say."""
        self.renderer.SetViewport(left, bottom, right, top)

    def _look(self, shown: Neighbourhood) -> None:
        parts = [fan.triangles.reshape(-1, 3) for fan in shown.fans]
        points = np.concatenate(parts) if parts else np.zeros((1, 3))
        frame = shown.frame
        flat = points @ frame.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        middle = (low + high) / 2 @ frame
        camera = self.renderer.GetActiveCamera()
        camera.SetFocalPoint(*middle)
        camera.SetPosition(*(middle + 10 * frame[2]))
        camera.SetViewUp(*frame[1])
        # Without perspective: nothing of what is laid side by side covers the rest.
        camera.SetParallelProjection(True)
        camera.SetParallelScale(1.1 * max(float((high - low)[:2].max()) / 2, 1e-3))
        self.renderer.ResetCameraClippingRange()


def fan_actors(fan: Fan) -> list[Any]:
    """Return the actors of one fan: faces in its colour, outlines, boundary and crowded edges, its vertex."""
    color = FAN_COLORS[(fan.number - 1) % len(FAN_COLORS)]
    points = fan.triangles.reshape(-1, 3).astype(np.float32)
    faces = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    outline = fan.triangles[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2, 3).astype(np.float32)
    actors = [
        drawing.surface(points, faces, None, "vertex", color=color),
        drawing.segments(outline, INK, 1.2),
    ]
    for kind, ends in (("boundary_edges", fan.boundary), ("nonmanifold_edges", fan.crowded)):
        if len(ends):
            style = STYLES[kind]
            actors.append(drawing.segments(ends.astype(np.float32), style.color, style.width + 1))
    actors.append(drawing.markers(fan.offset[None].astype(np.float32), (255, 255, 255), "disc", 11))
    return actors


def number_label(fan: Fan, scale: float) -> Any:
    """Return the fan's number as text beside its faces' middle."""
    from vtkmodules.vtkRenderingCore import vtkTextActor

    middle = fan.triangles.mean(axis=(0, 1))
    text = vtkTextActor()
    text.SetInput(str(fan.number))
    place = text.GetPositionCoordinate()
    place.SetCoordinateSystemToWorld()
    place.SetValue(*map(float, middle))
    look = text.GetTextProperty()
    look.SetFontSize(max(round(16 * scale), 9))
    look.BoldOn()
    look.SetColor(0.0, 0.0, 0.0)
    look.SetJustificationToCentered()
    look.SetVerticalJustificationToCentered()
    return text


def size_of(window: tuple[int, int], panel: Panel) -> int:
    """Return the side of the square the fans are drawn in: what is left under the text, in pixels."""
    width, height = window
    return max(min(int(panel.image.shape[1]), height - int(panel.image.shape[0]) - 40, width // 3), 60)


def background(panel: Panel, side: int) -> NDArray[np.uint8]:
    """Return the text's picture with white room of `side` pixels for the fans below."""
    height, width = panel.image.shape[:2]
    image = np.zeros((height + side, width, 4), np.uint8)
    image[:] = 255
    image[0, :, :3] = image[-1, :, :3] = image[:, 0, :3] = image[:, -1, :3] = 190
    text = panel.image[8:-2, 2:-2, :3]
    image[8 : height - 2, 2:-2, :3] = text
    return image
