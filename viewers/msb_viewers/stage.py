"""The VTK actors of a model: its surface, a simplified mesh for moving views, and the layers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import lit_grey
from msb_viewers import drawing
from msb_viewers.model import ViewModel
from msb_viewers.palette import Style
from msb_viewers.state import ViewState
from msb_viewers.viewed_mesh import Skin, color_bytes

# Minimum and maximum number of faces of a simplified mesh. A mesh with fewer faces is not simplified.
_MOST_FACES, _LEAST_FACES = 300_000, 30_000
# While the view moves, the full mesh is drawn only if a frame takes at most this many seconds (20 frames
# per second).
_FLUID_SECONDS = 0.05
# While the view moves, each layer draws at most (face budget) / _MARKS elements.
_MARKS = 5
# Lines and markers have their full size if the median edge is at least this long, in pixels.
_FULL_SIZE = 40.0
# Minimum scale of lines and markers.
_LEAST = 0.2
# Strength of shading, in [0, 1], when components are coloured. The shading is weak, because the lightness
# of a component indicates its size.
_SHADE_COMPONENTS = 0.25


class Stage:
    """The actors of a model. Actors (VTK objects to draw) are created when needed. Actors are stored as long
    as they are valid.

    `seconds` is the time of the last full frame. If the last full frame took too long, simplified meshes are
    drawn while the view is `moving`.

    `boost` enlarges lines and markers. For images that are printed small, set a larger `boost`.
    """

    def __init__(self, model: ViewModel, back: Any, front: Any) -> None:
        self.model, self._back, self._front = model, back, front
        self.moving = False
        self.seconds = 0.0
        self.boost = 1.0
        self.box: NDArray[np.float64] | None = None
        self._surface: list[Any] = []
        self._surface_of: Any = None
        self._stand_in: list[Any] = []
        self._layers: dict[str, tuple[Any, list[Any], list[Any]]] = {}
        self._coarse: tuple[NDArray[Any], NDArray[Any]] | None = None
        self._budget: int | None = None
        self._edge = median_edge(model)
        self._size = 1.0
        self._through = False

    def sync(self, state: ViewState) -> None:
        """Create, show and hide actors according to `state`."""
        faces = self.model.faces_of(state.component)
        key = (state.coloring, state.component)
        if self._surface_of != key:
            self._remove(self._surface + self._stand_in)
            self._surface_of, self._stand_in = key, []
            self._surface = [self._add(actor) for actor in self._make_surface(state, faces)]
        # If drawing the surface is slow, a simplified mesh replaces the surface while the view moves.
        if self.moving and not self._stand_in:
            self._budget = face_budget(len(faces), self.seconds)
        simplified = self.moving and self._budget is not None
        if simplified and not self._stand_in:
            self._stand_in = [self._add(self._make_stand_in(state))]
        for actor in self._surface:
            actor.SetVisibility(not simplified and len(faces) > 0)
        for actor in self._stand_in:
            actor.SetVisibility(simplified)
        self._sync_layers(state)
        drawing.clip(self.actors(), self.box)

    def actors(self) -> list[Any]:
        """Return all actors."""
        layers = [actor for _, full, thin in self._layers.values() for actor in (*full, *thin)]
        return self._surface + self._stand_in + layers

    def resize(self, pixels_per_unit: float) -> None:
        """Adapt the size of lines and markers to the zoom.

        Lines and markers are smaller if the edges of the mesh are short on the screen.
        """
        size = float(np.clip(self._edge * pixels_per_unit / _FULL_SIZE, _LEAST, 1.0))
        if abs(size - self._size) > 0.02:
            self._size = size
            for kind in self._layers:
                self._scale(kind)

    def _sync_layers(self, state: ViewState) -> None:
        """Create, show and hide the actors of the layers."""
        if state.through != self._through:
            # Layers in the second renderer are drawn over the surface.
            self._through = state.through
            self._forget_layers(set(self._layers))
        self._forget_layers({kind for kind, entry in self._layers.items() if entry[0] != state.component})
        for kind in sorted(state.visible - set(self._layers)):
            self._make_layer(kind, state.component)
        for kind, (_, full, thin) in self._layers.items():
            if self.moving and self._budget is not None and full and not thin:
                thin += self._thin(kind, state.component)
            thinned = self.moving and bool(thin) and self._budget is not None
            for actor in full:
                actor.SetVisibility(kind in state.visible and not thinned)
            for actor in thin:
                actor.SetVisibility(kind in state.visible and thinned)

    def _make_layer(self, kind: str, component: int | None) -> None:
        corners, style = self.model.positions(kind, component=component), self.model.layers[kind].style
        full = [self._add(actor, over=True) for actor in layer_actors(style, corners)] if len(corners) else []
        self._layers[kind] = (component, full, [])
        self._scale(kind)

    def _thin(self, kind: str, component: int | None) -> list[Any]:
        """Return actors of a sample of a layer with many elements, for moving views."""
        corners = self.model.positions(kind, component=component)
        most = max((self._budget or _MOST_FACES) // _MARKS, 1)
        if len(corners) <= most:
            return []
        sample = corners[:: -(-len(corners) // most)]
        thin = [self._add(actor, over=True) for actor in layer_actors(self.model.layers[kind].style, sample)]
        for actor in thin:
            self._scale_actor(kind, actor)
        return thin

    def _forget_layers(self, kinds: set[str]) -> None:
        for kind in kinds:
            _, full, thin = self._layers.pop(kind)
            self._remove(full + thin)

    def _scale(self, kind: str) -> None:
        for actor in (*self._layers[kind][1], *self._layers[kind][2]):
            self._scale_actor(kind, actor)

    def _scale_actor(self, kind: str, actor: Any) -> None:
        appearance = actor.GetProperty()
        style = self.model.layers[kind].style
        appearance.SetLineWidth(max(style.width * self._size, 0.8) * self.boost)
        appearance.SetPointSize(max(style.size * self._size, 3.0) * self.boost)

    def _make_surface(self, state: ViewState, rows: NDArray[Any]) -> list[Any]:
        """Return the actors of the faces `rows`.

        The faces have a single actor, or one actor for each texture.
        """
        everything = len(rows) == len(self.model.faces)
        faces = self.model.faces if everything else self.model.faces[rows]
        colors = self.model.colors
        if state.coloring != "own" or colors is None:
            return [self._plain_surface(state, faces, rows)]
        if self.model.skin is not None and len(rows):
            return [self._textured(self.model.skin, *part) for part in self.model.skin.by_texture(rows)]
        values = colors.values
        if colors.domain == "face" and not everything:
            values = values[rows]
        elif colors.domain == "corner" and not everything:
            values = values.reshape(-1, 3, 3)[rows].reshape(-1, 3)
        return [drawing.surface(self.model.points, faces, values, colors.domain)]

    def _textured(self, skin: Skin, number: int, rows: NDArray[Any]) -> Any:
        """Return the actor of the faces `rows`, which use the texture with index `number`."""
        tint = None if skin.tint is None else skin.tint.reshape(-1, 3, 4)[rows].reshape(-1, 4)
        textures = skin.textured
        appearance = (textures.uvs[rows], textures.images[number], textures.sampler, tint, skin.cutoff)
        return drawing.textured(self.model.points, self.model.faces[rows], *appearance)

    def _make_stand_in(self, state: ViewState) -> Any:
        """Return the actor of a simplified mesh, in the colours of the surface."""
        model = self.model
        coarse = self._coarse
        if coarse is None or state.component is not None:
            rows = model.faces_of(state.component)
            faces, origin = simplify(model.points, model.faces[rows], self._budget or _MOST_FACES)
            coarse = faces, rows[origin]
            if state.component is None:
                self._coarse = coarse
        faces, origin = coarse
        colors = model.colors
        if state.coloring != "own" or colors is None:
            return self._plain_surface(state, faces, origin)
        if colors.domain == "vertex":
            return drawing.surface(model.points, faces, colors.values, "vertex")
        first = origin * (3 if colors.domain == "corner" else 1)
        return drawing.surface(model.points, faces, colors.values[first], "face")

    def _plain_surface(self, state: ViewState, faces: NDArray[Any], origin: NDArray[Any]) -> Any:
        """Return the actor of faces (n, 3) in grey, or in the colours of their components.

        `origin` (n,) are the indices of the faces in the model.
        """
        if state.coloring != "components":
            points = self.model.points
            return drawing.surface(points, faces, color_bytes(lit_grey(points, faces, self.model.up)), "face")
        colors = self.model.component_colors()[origin]
        return drawing.surface(self.model.points, faces, colors, "face", shade=_SHADE_COMPONENTS)

    def _add(self, actor: Any, *, over: bool = False) -> Any:
        (self._front if over and self._through else self._back).AddActor(actor)
        return actor

    def _remove(self, actors: list[Any]) -> None:
        for actor in actors:
            self._back.RemoveActor(actor)
            self._front.RemoveActor(actor)


def layer_actors(style: Style, corners: NDArray[np.float32]) -> list[Any]:
    """Return the actors of elements with positions (n, k, 3): lines, markers, or both."""
    actors = []
    if style.width:
        ends = corners
        if style.of == "face":  # this call draws the outlines of faces
            ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        actors.append(drawing.segments(ends, style.color, style.width, dashed=style.line == "dashed"))
    if style.marker is not None:
        actors.append(drawing.markers(corners.mean(axis=1), style.color, style.marker, style.size))
    return actors


def median_edge(model: ViewModel) -> float:
    """Return the median length of a sample of edges, in view units."""
    pairs = model.analysis.mesh.edge_vertices
    pairs = pairs[:: max(len(pairs) // 20_000, 1)]
    pairs = pairs[model.finite(pairs)] if len(pairs) else pairs
    if len(pairs) == 0:
        return 1.0
    return float(np.median(np.linalg.norm(model.points[pairs[:, 0]] - model.points[pairs[:, 1]], axis=1)))


def face_budget(faces: int, seconds: float) -> int | None:
    """Return the number of faces to draw while the view moves. Drawing all faces takes `seconds`.

    If the result is None, all faces are drawn.

    >>> face_budget(1_000_000, 0.02), face_budget(1_000_000, 0.5), face_budget(4_000_000, 0.1)
    (None, 100000, 300000)
    >>> face_budget(10_000, 1.0)
    """
    if seconds <= _FLUID_SECONDS or faces <= _LEAST_FACES:
        return None
    return int(min(max(faces * _FLUID_SECONDS / seconds, _LEAST_FACES), _MOST_FACES))


def simplify(
    points: NDArray[np.float32], faces: NDArray[Any], target: int = _MOST_FACES
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the faces (f, 3) of a simplified mesh. The second result (f,) gives, for each face, the original
    face whose colour is used.

    The number of faces is between half of `target` and twice `target`. The method is vertex clustering
    (Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993). The
    function takes O(V + F) time, and sorts at most 4 `target` faces.
    """
    # If there are very many faces, use a random sample.
    sample = np.arange(len(faces))
    if len(faces) > 4 * target:
        sample = np.random.default_rng(0).choice(len(faces), 4 * target, replace=False)
        sample.sort()
    some = faces[sample]
    if len(some) == 0:
        return some, sample
    low, high = points[some].reshape(-1, 3).min(axis=0), points[some].reshape(-1, 3).max(axis=0)
    # In a grid of n^3 cells, a surface intersects a small multiple of n^2 cells. On average, a grid cell that
    # the surface intersects contains about four faces.
    cells = max(int(np.sqrt(target / 4)), 8)
    size = max(float((high - low).max()) / cells, 1e-9)
    # Replace each vertex by the first vertex in its grid cell, (V,).
    used = np.unique(some)
    place = np.floor((points[used] - low) / size).astype(np.int64)
    key = (place[:, 0] * (cells + 2) + place[:, 1]) * (cells + 2) + place[:, 2]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    stand_in = np.zeros(len(points), some.dtype)
    stand_in[used] = used[first][inverse]
    coarse = stand_in[some]
    # Keep faces with three different vertices, and remove repeated faces.
    a, b, c = coarse.T
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    rows = np.sort(coarse[whole], axis=1).astype(np.int64)
    _, once = np.unique((rows[:, 0] * len(points) + rows[:, 1]) ^ (rows[:, 2] << 40), return_index=True)
    keep = whole[np.sort(once)]
    if len(keep) > 2 * target:
        keep = keep[:: len(keep) // target]
    return coarse[keep], sample[keep]
