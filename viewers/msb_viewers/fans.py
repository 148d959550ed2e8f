"""The fan inspector: the fans at a vertex, drawn apart in a corner of the window."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers import drawing
from msb_viewers.camera import sphere
from msb_viewers.model import ViewModel
from msb_viewers.palette import FAN_COLORS, INK, STYLES
from msb_viewers.sheet import Panel, list_panel

# The least distance by which a fan is moved, in radii of the faces at the vertex.
_APART = 0.6
# The length of the circle that each fan gets, in the same radii.
_ROOM = 0.9
# At most this many fans are drawn; more would cover each other. The text counts all.
_MOST_FANS = 12
# The most lines of text; the drawing shows the other fans, too.
_MOST_LINES = 8


@dataclass(frozen=True, eq=False)
class Fan:
    """Faces (n,) at a vertex that are joined across two-face edges, and where they are drawn.

    `triangles` (n, 3, 3) are in radii of the neighbourhood, from the vertex, moved by `offset`; `boundary`
    and `crowded` (k, 2, 3) are the fan's edges at the vertex that have one face, and more than two.
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
    """All fans at a vertex, and what the audit says about the vertex."""

    fans: tuple[Fan, ...]
    fan_count: int
    group_count: int
    on_crowded_edge: bool
    # (3, 3) rows: right, up and towards the eye, for the view in which the fans lie side by side.
    frame: NDArray[np.float64]

    @property
    def verdict(self) -> str:
        """What the vertex is, in words."""
        if self.fan_count == 0:
            return "no proper face uses it"
        if self.fan_count == 1:
            return "manifold: one fan"
        kinds = ["bow-tie"] if self.group_count > 1 else []
        kinds += ["on a non-manifold edge"] if self.on_crowded_edge else []
        return f"non-manifold: {self.fan_count} fans ({', '.join(kinds)})"

    def lines(self) -> list[str]:
        """Return one line of text for each drawn fan."""
        texts = [
            f"fan {fan.number}: {_plural(len(fan.faces), 'face')}, {'closed' if fan.closed else 'open'}"
            for fan in self.fans
        ]
        more = self.fan_count - len(self.fans)
        return [*texts, f"and {_plural(more, 'more fan')}"] if more else texts


def neighbourhood(model: ViewModel, vertex: int) -> Neighbourhood:
    """Return the fans at `vertex`, each moved away from it. O(F) time."""
    analysis, faces = model.analysis, model.faces
    rows, corners = np.nonzero(faces == vertex)
    fan_of = analysis.fans.corner_fan[3 * rows + corners]
    proper = (fan_of >= 0) & model.drawn[rows]
    rows, corners, fan_of = rows[proper], corners[proper], fan_of[proper]
    center = model.points[vertex].astype(np.float64)
    triangles = model.points[faces[rows]].astype(np.float64) - center
    radius = float(np.linalg.norm(triangles, axis=2).max(initial=0.0)) or 1.0
    triangles /= radius
    fan_numbers, part = np.unique(fan_of, return_inverse=True)
    # The largest fans first: they are what the eye takes for the surface.
    order = np.argsort(-np.bincount(part, minlength=len(fan_numbers)), kind="stable")[:_MOST_FANS]
    frame = _frame(triangles, part)
    towards = np.array([triangles[part == index].mean(axis=(0, 1)) for index in order]).reshape(-1, 3)
    offsets = _spread(towards @ frame[:2].T) @ frame[:2]
    fans = []
    for number, (index, offset) in enumerate(zip(order, offsets, strict=True), 1):
        chosen = part == index
        fans.append(_fan(model, number, rows[chosen], corners[chosen], triangles[chosen], offset))
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
    # The two half-edges of each face at the vertex: the one that leaves it and the one that comes in.
    leaving, coming = 3 * rows + corners, 3 * rows + (corners + 2) % 3
    faces_at_edge = model.analysis.mesh.multiplicity
    edge = model.analysis.mesh.edge
    index = np.arange(len(rows))
    far = np.concatenate([triangles[index, (corners + 1) % 3], triangles[index, (corners + 2) % 3]])
    number_of = np.concatenate([edge[leaving], edge[coming]])
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
    """Return offsets (n, 2) on a circle: in the order of the fans' own directions, evenly apart.

    The circle is as large as the fans need, each of them being up to one radius long.
    """
    count = len(directions)
    if count < 2:
        return np.zeros((count, 2))
    angle = np.arctan2(directions[:, 1], directions[:, 0])
    place = np.zeros(count)
    place[np.argsort(angle, kind="stable")] = np.arange(count)
    even = 2 * np.pi * place / count
    # Turned as a whole to where the fans are, so that each moves little.
    even += float(np.angle(np.exp(1j * (angle - even)).mean()))
    radius = max(_APART, _ROOM * count / (2 * np.pi))
    return radius * np.stack([np.cos(even), np.sin(even)], axis=1)


def _frame(triangles: NDArray[np.float64], part: NDArray[Any]) -> NDArray[np.float64]:
    """Return right, up and forward (3, 3) such that the fan seen most edge-on is seen as well as can be.

    `part` (n,) is the fan of each of the `triangles` (n, 3, 3).
    """
    if len(triangles) == 0:
        return np.eye(3)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    directions = sphere(128)
    seen = np.zeros((part.max() + 1, len(directions)))
    np.add.at(seen, part, np.abs(normal @ directions.T))
    whole = np.bincount(part, weights=np.linalg.norm(normal, axis=1))
    share = seen[whole > 0] / whole[whole > 0, None]
    if len(share) == 0:
        return np.eye(3)
    # The worst fan first; among like views the one that shows most of all of them.
    forward = directions[int(np.argmax(share.min(axis=0) + 0.1 * share.mean(axis=0)))]
    right = np.cross(np.eye(3)[int(np.argmin(np.abs(forward)))], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _plural(count: int, word: str) -> str:
    return f"{count:,} {word}{'' if count == 1 else 's'}"


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
