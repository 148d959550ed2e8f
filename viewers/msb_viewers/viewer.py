"""The topology viewer: a window, or an image of its content."""

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.matrices import inverse
from msb.errors import UsageError
from msb_viewers import drawing
from msb_viewers.camera import FOV_Y, Pose, component_pose, default_pose, element_pose
from msb_viewers.controls import TopologyControls
from msb_viewers.fans import Inset, background, size_of
from msb_viewers.gl import NO_DISPLAY
from msb_viewers.legend import legend_panel
from msb_viewers.model import ViewModel
from msb_viewers.palette import BACKGROUND, HIGHLIGHT, unit
from msb_viewers.picking import pick
from msb_viewers.sheet import LEGEND_WIDTH, Panel, help_panel, line_panel, text_scale, write_png
from msb_viewers.stage import Stage
from msb_viewers.state import HELP, ViewState

# Distance between panels and the border of the window, in pixels at scale 1.
_GAP = 12
# Samples per pixel that smooth the edges of faces and lines while the view does not move.
_SAMPLES = 4
# Number of frames of the camera movement to an element. At 60 frames per second, it takes a quarter of a
# second.
_FLIGHT_FRAMES = 14


class TopologyViewer:
    """A view of a mesh and its defects, in a window or off-screen. Only `show` needs a window.

    `up` is the axis that points up, such as "+y". The default is the axis of the model. `state` is the
    initial state.
    """

    def __init__(
        self,
        model: ViewModel,
        *,
        size: tuple[int, int] = (1280, 800),
        off_screen: bool = False,
        up: str | None = None,
        state: ViewState | None = None,
    ) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkRenderer

        drawing.silence_vtk()
        self.off_screen = off_screen
        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(size), lighting="none")
        self.window = self.plotter.ren_win
        if not off_screen and self.window.GetClassName() in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"):
            self.plotter.close()
            raise UsageError("VIEW_NO_DISPLAY", NO_DISPLAY)
        self.title = f"{model.name} - msb view"
        self.window.SetWindowName(self.title)
        self.plotter.set_background(unit(BACKGROUND))
        self.plotter.camera_set = True  # otherwise VTK would reset the camera in the first frame
        self.renderer = self.plotter.renderer
        self.camera = self.renderer.GetActiveCamera()
        self.model, self.up, self._extent = model, up or model.up, model.extent
        self.state = state or ViewState.first(model)
        self.renderer.SetTwoSidedLighting(True)
        self.renderer.SetAutomaticLightCreation(True)
        self.front = vtkRenderer()
        self.front.SetLayer(1)
        self.front.InteractiveOff()
        self.window.SetNumberOfLayers(3)
        self.window.AddRenderer(self.front)
        self.camera.SetViewAngle(math.degrees(FOV_Y))
        self.front.SetActiveCamera(self.camera)
        self.stage = Stage(model, self.renderer, self.front)
        self.inset = Inset(self.window, layer=2)
        self._overlays = {name: drawing.Overlay() for name in ("legend", "help", "status", "fans")}
        for picture in self._overlays.values():
            self.front.AddViewProp(picture.actor)
        self._legend: Panel | None = None
        self._marks: list[Any] = []
        self._fans_request: tuple[int | None, float] = (None, 0.0)
        self.controls = TopologyControls(self)
        self.home()
        self.refresh()

    # --- window

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the window in pixels."""
        width, height = self.window.GetSize()
        return int(width), int(height)

    @property
    def scale(self) -> float:
        """The scale of all text, which follows the size of the window."""
        return text_scale(self.size)

    @property
    def pose(self) -> Pose:
        """The pose of VTK's camera."""
        places = (self.camera.GetPosition(), self.camera.GetFocalPoint(), self.camera.GetViewUp())
        return Pose(*(np.array(place, np.float64) for place in places))

    @pose.setter
    def pose(self, pose: Pose) -> None:
        self.camera.SetPosition(*pose.eye)
        self.camera.SetFocalPoint(*pose.target)
        self.camera.SetViewUp(*pose.up)

    def image(self) -> NDArray[np.uint8]:
        """Draw the window and return its image (H, W, 3). Row 0 is at the top."""
        self.refresh()
        return np.asarray(self.plotter.screenshot(None, return_img=True), np.uint8)[..., :3]

    def screenshot(self, path: Path) -> None:
        """Write the window to a PNG file."""
        write_png(self.image(), path)

    def show(self) -> None:
        """Open the window, and return when the user closes it."""
        self.controls.attach()
        self.refresh()
        self.plotter.show(auto_close=True, title=self.title)

    # --- drawing

    def refresh(self) -> None:
        """Update the window from the state, and draw the window."""
        self.stage.sync(self.state)
        self._mark_selection()
        self._show_fans()
        self.center()
        self._show_text()
        self.render()

    def render(self) -> None:
        """Draw the window, with lines and markers for the current zoom."""
        self.stage.resize(self.pixels_per_unit())
        self.fit_depth()
        # Multisampling smooths edges and does not change colours inside of faces.
        self.window.SetMultiSamples(0 if self.stage.moving else _SAMPLES)
        start = time.perf_counter()
        self.window.Render()
        if not self.stage.moving:
            self.window.WaitForCompletion()
            self.stage.seconds = time.perf_counter() - start

    def pixels_per_unit(self) -> float:
        """Return the number of pixels per view unit at the distance of the camera's target."""
        return self.size[1] / (2 * max(self.pose.distance, 1e-9) * math.tan(FOV_Y / 2))

    # --- camera

    def home(self) -> None:
        """Go to the first view, centred in the area without the legend."""
        self.pose = default_pose(self.up, self._aspect())
        self.center()

    def center(self) -> None:
        """Centre the view in the area without the legend and the fans."""
        fans = self._overlays["fans"]
        right = fans.size[0] + round(_GAP * self.scale) if fans.actor.GetVisibility() else 0
        self.camera.SetWindowCenter((right - self._taken()) / self.size[0], 0.0)

    def fly(self, pose: Pose) -> None:
        """Move the camera to a pose. In a window, the camera movement is animated."""
        start = self.pose
        for step in range(1, _FLIGHT_FRAMES if not self.off_screen else 0):
            t = step / _FLIGHT_FRAMES
            t = t * t * (3 - 2 * t)
            parts = [
                (1 - t) * a + t * b for a, b in zip(vars(start).values(), vars(pose).values(), strict=True)
            ]
            self.pose = Pose(*parts)
            self.stage.moving = True
            self.stage.sync(self.state)
            self.render()
        self.stage.moving = False
        self.pose = pose

    def fly_to_selection(self) -> None:
        """Go to the selected element or vertex, if its position is finite."""
        vertices = self._selected_vertices()
        if vertices is None:
            self.state.message = "Nothing is selected: click a vertex, or use N and P"
            return
        pose = element_pose(self.model, vertices, self.pose)
        if pose is not None:
            self.fly(pose)

    def fly_to_component(self) -> None:
        """Go to the isolated component. If no component is isolated, go to the first view."""
        component = self.state.component
        if component is None:
            self.home()
            return
        pose = component_pose(self.model, component, self.pose, self._aspect())
        if pose is not None:
            self.fly(pose)

    def project(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Return the pixels (n, 2) of positions (n, 3) in view units. The origin is the top left corner."""
        width, height = self.size
        matrix = self._matrix()
        ends = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ matrix.T
        with np.errstate(divide="ignore", invalid="ignore"):
            device = ends[:, :2] / ends[:, 3:]
        return np.stack([(device[:, 0] + 1) / 2 * width, (1 - device[:, 1]) / 2 * height], axis=1)

    def pick(self, x: float, y: float) -> int | None:
        """Find the face at a pixel. Select the vertex of this face that is nearest to the pixel.

        Return the selected vertex, or None.
        """
        # Find a point on the near plane and a point on the far plane. The two points define the ray through
        # the pixel.
        width, height = self.size
        back = inverse(self._matrix())
        device = np.array([2 * x / width - 1, 1 - 2 * y / height])
        near, far = (back @ np.array([*device, depth, 1.0]) for depth in (-1.0, 1.0))
        eye, end = near[:3] / near[3], far[:3] / far[3]
        direction = (end - eye) / np.linalg.norm(end - eye)
        allowed = self.model.drawn
        if self.state.component is not None:
            allowed = allowed & (self.model.face_component == self.state.component)
        hit = pick(self.model.points, self.model.faces, allowed, eye, direction, self.stage.box)
        self.state.choose_vertex(None if hit is None else hit.vertex)
        self.refresh()
        return self.state.vertex

    def fit_depth(self) -> None:
        """Set near and far planes around the mesh, with a ratio that keeps the depth buffer precise."""
        pose, extent = self.pose, self._extent
        away = float(np.linalg.norm(pose.eye))
        far = extent + away
        near = max((away - extent) * 0.99, pose.distance * 0.05, far * 1e-5)
        self.camera.SetClippingRange(near, far * 1.01)

    def set_box(self, box: NDArray[Any] | None) -> None:
        """Draw only the part inside a box (3, 2) in view units. None draws everything."""
        self.stage.box = None if box is None else np.asarray(box, np.float64)
        drawing.clip(self.stage.actors(), self.stage.box)

    # --- legend and end

    def close(self) -> None:
        """Release the window and all VTK objects. `close` can be called twice."""
        self.window.RemoveRenderer(self.front)
        self.window.RemoveRenderer(self.inset.renderer)
        self.plotter.close()

    def legend_hit(self, x: float, y: float) -> str | None:
        """Return the legend's action at a pixel.

        For the legend's background the result is "", and outside the legend it is None.
        """
        if self._legend is None:
            return None
        gap = round(_GAP * self.scale)
        return self._legend.hit(x - gap, y - gap)

    # --- parts

    def _taken(self) -> int:
        """Return the width of the legend and its margin in pixels."""
        if not self.state.legend:
            return 0
        return round(LEGEND_WIDTH * self.scale) + round(_GAP * self.scale)

    def _aspect(self) -> float:
        """Return the aspect ratio (width / height) of the area without the legend."""
        width, height = self.size
        return (width - self._taken()) / height

    def _matrix(self) -> NDArray[np.float64]:
        """Return the matrix (4, 4) from view units to device coordinates in [-1, 1]."""
        width, height = self.size
        self.fit_depth()
        matrix = self.camera.GetCompositeProjectionTransformMatrix(width / height, -1.0, 1.0)
        return np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])

    def _selected_vertices(self) -> NDArray[Any] | None:
        if self.state.element is not None:
            kind, place = self.state.element
            return np.asarray(self.model.layers[kind].vertices[place])
        return None if self.state.vertex is None else np.array([self.state.vertex])

    def _mark_selection(self) -> None:
        """Draw a ring around the selection, in front of all other objects."""
        for actor in self._marks:
            self.front.RemoveActor(actor)
        self._marks = []
        vertices = self._selected_vertices()
        if vertices is None or not self.model.finite(vertices[None])[0]:
            return
        corners = self.model.points[vertices]
        if len(corners) > 1:
            ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)[: 1 if len(corners) == 2 else 3]
            self._marks.append(drawing.segments(ends, HIGHLIGHT, 4.0))
        self._marks.append(drawing.markers(corners.mean(axis=0)[None], HIGHLIGHT, "ring", 34.0))
        for actor in self._marks:
            self.front.AddActor(actor)

    def _show_fans(self) -> None:
        """Show the fans of the selected vertex in the lower right corner."""
        request = (self.state.vertex, self.scale)
        if request == self._fans_request and self.state.vertex is None:
            return
        # If the vertex or the scale changed, create the actors and the text again.
        if request != self._fans_request:
            text = self.inset.show(self.model, self.state.vertex, self.scale)
            if text:
                at = self.state.component_of_vertex(int(self.state.vertex or 0))
                of = "" if at is None else f" · {self.state.describe_component(at)}"
                self.state.message = text + of
            self._fans_request = request
        picture, panel = self._overlays["fans"], self.inset.panel
        self.inset.renderer.SetDraw(panel is not None and not self.state.help)
        if panel is None or self.state.help:
            picture.hide()
            return
        (width, height), gap = self.size, round(_GAP * self.scale)
        side = size_of(self.size, panel)
        picture.set(background(panel, side))
        left = width - picture.size[0] - gap
        picture.place(left, gap)
        inner = (picture.size[0] - side) // 2
        x = left + inner
        self.inset.renderer.SetViewport(x / width, gap / height, (x + side) / width, (gap + side) / height)

    def _show_text(self) -> None:
        """Show the panels of text: legend, status line and help."""
        (width, height), scale = self.size, self.scale
        gap = round(_GAP * scale)
        self._legend = None
        legend = self._overlays["legend"]
        if self.state.legend:
            self._legend = legend_panel(self.state, scale)
            legend.set(self._legend.image)
            legend.place(gap, height - gap - legend.size[1])
        else:
            legend.hide()
        status = self._overlays["status"]
        fans = self._overlays["fans"]
        taken = fans.size[0] + gap if fans.actor.GetVisibility() else 0
        left = self._taken() + gap if self.state.legend and legend.size[1] > height - 5 * gap else gap
        if self.state.message and width - left - taken > 120:
            status.set(line_panel(self.state.message, width - left - taken - gap, scale).image)
            status.place(left, gap)
        else:
            status.hide()
        helping = self._overlays["help"]
        if self.state.help:
            helping.set(help_panel(HELP, scale).image)
            free = self._taken()
            x = free + (width - free - helping.size[0]) // 2
            helping.place(min(max(x, 0), max(width - helping.size[0], 0)), (height - helping.size[1]) // 2)
        else:
            helping.hide()
