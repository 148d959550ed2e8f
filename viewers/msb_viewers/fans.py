"""The fan inspector: the fans at a vertex, drawn separately in a corner of the window.

A fan is a set of faces at a vertex that are connected through edges with exactly two faces.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers import drawing
from msb_viewers.camera import sphere
from msb_viewers.model import ViewModel
from msb_viewers.palette import FAN_COLORS, INK, STYLES
from msb_viewers.sheet import Panel, list_panel

# Minimum distance by which a fan of faces is moved. The unit is the radius of the faces at the vertex.
_APART = 0.6
# Length of the arc that each fan of faces needs on the circle. The unit is the radius of the faces at the
# vertex.
_ROOM = 0.9
# Maximum number of fans of faces that are drawn. If more fans were drawn, the drawings would overlap. The
# text counts all fans at the vertex.
_MOST_FANS = 12
# Maximum number of lines in the text of the fan inspector.
_MOST_LINES = 8


@dataclass(frozen=True, eq=False)
class Fan:
    """A fan of faces around a vertex: its faces (n,), and the positions of these faces in the drawing.

    `triangles` (n, 3, 3) are relative to the vertex, and they are moved by `offset`. The unit is the radius
    of the faces at the vertex. `boundary` (k, 2, 3) contains the edges at the vertex with one face. `crowded`
    (k, 2, 3) contains the edges with more than two faces.
    """

    number: int
    faces: NDArray[Any]
    triangles: NDArray[np.float64]
    offset: NDArray[np.float64]
    closed: bool
    boundary: NDArray[np.float64]
    crowded: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """All fans of faces at a vertex, and the counts of the audit."""

    fans: tuple[Fan, ...]
    fan_count: int
    group_count: int
    on_crowded_edge: bool
    # Axes (3, 3) of the view that shows the fans side by side. The three rows point right, up and towards
    # the camera.
    frame: NDArray[np.float64]

    @property
    def verdict(self) -> str:
        """The kind of the vertex as text."""
        if self.fan_count == 0:
            return "no valid face uses this vertex"
        if self.fan_count == 1:
            return "manifold: one fan"
        kinds = ["bow-tie"] if self.group_count > 1 else []
        kinds += ["on a non-manifold edge"] if self.on_crowded_edge else []
        return f"non-manifold: {self.fan_count} fans ({', '.join(kinds)})"

    def lines(self) -> list[str]:
        """Return one line of text for each drawn fan of faces.

        The last line contains the number of fans that are not drawn.
        """
        texts = [
            f"fan {fan.number}: {_plural(len(fan.faces), 'face')}, {'closed' if fan.closed else 'open'}"
            for fan in self.fans
        ]
        more = self.fan_count - len(self.fans)
        return [*texts, f"and {_plural(more, 'more fan')}"] if more else texts


def find_neighbourhood(model: ViewModel, vertex: int) -> Neighbourhood:
    """Return the fans of faces around `vertex`. Each fan is moved away from the vertex. O(F) time."""
    # Find the valid faces (n,) with a corner at the vertex, and the fan of each face.
    analysis, faces = model.analysis, model.faces
    rows, corners = np.nonzero(faces == vertex)
    fan_of = analysis.fans.corner_fan[3 * rows + corners]
    proper = (fan_of >= 0) & model.drawn[rows]
    rows, corners, fan_of = rows[proper], corners[proper], fan_of[proper]
    # Compute the corners (n, 3, 3) of these faces relative to the vertex, scaled to radius 1.
    center = model.points[vertex].astype(np.float64)
    triangles = model.points[faces[rows]].astype(np.float64) - center
    radius = float(np.linalg.norm(triangles, axis=2).max(initial=0.0)) or 1.0
    triangles /= radius
    fan_numbers, part = np.unique(fan_of, return_inverse=True)
    # Sort the fans of faces by size. The largest fan comes first.
    order = np.argsort(-np.bincount(part, minlength=len(fan_numbers)), kind="stable")[:_MOST_FANS]
    # Move each fan along the direction of its centroid in the view plane.
    frame = _frame(triangles, part)
    towards = np.array([triangles[part == index].mean(axis=(0, 1)) for index in order]).reshape(-1, 3)
    offsets = _spread(towards @ frame[:2].T) @ frame[:2]
    fans = []
    for number, (index, offset) in enumerate(zip(order, offsets, strict=True), 1):
        of_fan = part == index
        fans.append(_fan(model, number, rows[of_fan], corners[of_fan], triangles[of_fan], offset))
    return Neighbourhood(
        fans=tuple(fans),
        fan_count=int(analysis.fans.fans_per_vertex[vertex]),
        group_count=int(analysis.fans.groups_per_vertex[vertex]),
        on_crowded_edge=any(len(fan.crowded) for fan in fans),
        frame=frame,
    )


def _fan(
    model: ViewModel,
    number: int,
    rows: NDArray[Any],
    corners: NDArray[Any],
    triangles: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> Fan:
    """Return a fan that consists of the faces `rows` (n,).

    `corners` (n,) is the index of the corner at the vertex for each face.
    """
    # For each face, find its two half-edges at the vertex, and the vertices at their other ends.
    leaving, coming = 3 * rows + corners, 3 * rows + (corners + 2) % 3
    faces_at_edge = model.analysis.mesh.multiplicity
    edge = model.analysis.mesh.edge
    index = np.arange(len(rows))
    far = np.concatenate([triangles[index, (corners + 1) % 3], triangles[index, (corners + 2) % 3]])
    number_of = np.concatenate([edge[leaving], edge[coming]])
    # Find the distinct edges at the vertex, and count the faces of each edge.
    _, once = np.unique(number_of, return_index=True)
    count = faces_at_edge[number_of[once]]
    spokes = np.stack([np.zeros((len(once), 3)), far[once]], axis=1) + offset
    return Fan(
        number=number,
        faces=rows,
        triangles=triangles + offset,
        offset=offset,
        closed=bool((count == 2).all()) and len(once) == len(rows),
        boundary=spokes[count == 1],
        crowded=spokes[count > 2],
    )


def _spread(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return offsets (n, 2) at equal angles on a circle, in the angular order of `directions` (n, 2).

    The circle is large enough for fans of radius 1.
    """
    count = len(directions)
    if count < 2:
        return np.zeros((count, 2))
    angle = np.arctan2(directions[:, 1], directions[:, 0])
    place = np.zeros(count)
    place[np.argsort(angle, kind="stable")] = np.arange(count)
    even = 2 * np.pi * place / count
    # Rotate all angles by the same amount, so that the fans move as little as possible.
    even += float(np.angle(np.exp(1j * (angle - even)).mean()))
    radius = max(_APART, _ROOM * count / (2 * np.pi))
    return radius * np.stack([np.cos(even), np.sin(even)], axis=1)


def _frame(triangles: NDArray[np.float64], part: NDArray[Any]) -> NDArray[np.float64]:
    """Return the axes (3, 3) of a view in which all fans are well visible. The rows of the matrix point
    right, up and towards the camera.

    `part` (n,) is the index of the fan for each triangle in `triangles` (n, 3, 3).
    """
    if len(triangles) == 0:
        return np.eye(3)
    # Compute the visible fraction of each fan's area, projected along 128 directions.
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    directions = sphere(128)
    seen = np.zeros((part.max() + 1, len(directions)))
    np.add.at(seen, part, np.abs(normal @ directions.T))
    whole = np.bincount(part, weights=np.linalg.norm(normal, axis=1))
    share = seen[whole > 0] / whole[whole > 0, None]
    if len(share) == 0:
        return np.eye(3)
    # First maximise the visibility of the least visible fan, then the average visibility of all fans.
    forward = directions[int(np.argmax(share.min(axis=0) + 0.1 * share.mean(axis=0)))]
    right = np.cross(np.eye(3)[int(np.argmin(np.abs(forward)))], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _plural(count: int, word: str) -> str:
    return f"{count:,} {word}{'' if count == 1 else 's'}"


class Inset:
    """The renderer in the lower right corner that draws the fans of faces, and the text above this corner."""

    def __init__(self, window: Any, layer: int) -> None:
        from vtkmodules.vtkRenderingCore import vtkRenderer

        self.renderer = vtkRenderer()
        self.renderer.SetLayer(layer)
        self.renderer.InteractiveOff()
        self.renderer.DrawOff()
        window.AddRenderer(self.renderer)
        self.neighbourhood: Neighbourhood | None = None
        self.panel: Panel | None = None

    def show(self, model: ViewModel, vertex: int | None, scale: float) -> str:
        """Show the fans of faces at a vertex.

        If the vertex is None, show nothing. Return the message for the status line.
        """
        self.renderer.RemoveAllViewProps()
        self.renderer.SetDraw(vertex is not None)
        if vertex is None:
            self.neighbourhood = self.panel = None
            return ""
        around = self.neighbourhood = find_neighbourhood(model, vertex)
        for fan in around.fans:
            for actor in fan_actors(fan):
                self.renderer.AddActor(actor)
            self.renderer.AddViewProp(number_label(fan, scale))
        self._set_camera(around)
        lines: list[Any] = [
            (text, FAN_COLORS[index % len(FAN_COLORS)] if index < len(around.fans) else None)
            for index, text in enumerate(around.lines())
        ]
        row = model.row_in_file(vertex)
        self.panel = list_panel(f"Vertex {row:,}", around.verdict, lines[:_MOST_LINES], scale)
        return f"Vertex {row}: {around.verdict}"

    def _set_camera(self, around: Neighbourhood) -> None:
        """Point the camera at all fans of faces, along the third axis of the view."""
        parts = [fan.triangles.reshape(-1, 3) for fan in around.fans]
        points = np.concatenate(parts) if parts else np.zeros((1, 3))
        frame = around.frame
        flat = points @ frame.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        middle = (low + high) / 2 @ frame
        camera = self.renderer.GetActiveCamera()
        camera.SetFocalPoint(*middle)
        camera.SetPosition(*(middle + 10 * frame[2]))
        camera.SetViewUp(*frame[1])
        # Draw without perspective, so that neighbouring fans do not cover each other.
        camera.SetParallelProjection(True)
        camera.SetParallelScale(1.1 * max(float((high - low)[:2].max()) / 2, 1e-3))
        self.renderer.ResetCameraClippingRange()


def fan_actors(fan: Fan) -> list[Any]:
    """Return the actors of a fan: its faces, outlines, boundary and non-manifold edges, and the vertex."""
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
    """Return the number of a fan as text at the centroid of its faces."""
    from vtkmodules.vtkRenderingCore import vtkTextActor

    middle = fan.triangles.mean(axis=(0, 1))
    text = vtkTextActor()
    text.SetInput(str(fan.number))
    place = text.GetPositionCoordinate()
    place.SetCoordinateSystemToWorld()
    place.SetValue(*map(float, middle))
    font = text.GetTextProperty()
    font.SetFontSize(max(round(16 * scale), 9))
    font.BoldOn()
    font.SetColor(0.0, 0.0, 0.0)
    font.SetJustificationToCentered()
    font.SetVerticalJustificationToCentered()
    return text


def size_of(window: tuple[int, int], panel: Panel) -> int:
    """Return the side length in pixels of the square for the fans. The square is below the text."""
    width, height = window
    return max(min(int(panel.image.shape[1]), height - int(panel.image.shape[0]) - 40, width // 3), 60)


def background(panel: Panel, side: int) -> NDArray[np.uint8]:
    """Return the image of the text.

    Below the text, the image has a white square of `side` pixels for the fans.
    """
    height, width = panel.image.shape[:2]
    image = np.zeros((height + side, width, 4), np.uint8)
    image[:] = 255
    image[0, :, :3] = image[-1, :, :3] = image[:, 0, :3] = image[:, -1, :3] = 190
    text = panel.image[8:-2, 2:-2, :3]
    image[8 : height - 2, 2:-2, :3] = text
    return image
