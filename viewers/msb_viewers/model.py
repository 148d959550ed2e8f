"""What the topology viewer shows, as plain arrays: no window, no VTK, nothing that needs a display."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import known_up
from msb.topology import Audit
from msb.topology.analysis import Analysis
from msb_viewers.palette import NEUTRAL, SIZE_CLASSES, STYLES, Style
from msb_viewers.viewed_mesh import Colors, Skin, ViewedMesh

SOUP_NOTE = "Triangle soup: no two faces share a vertex, so every edge is a boundary; these are not drawn."
CLEAN_NOTE = "Nothing wrong: closed, manifold, consistently wound."
EMPTY_NOTE = "There is no face to draw."
_WORST_FIRST = (
    "degenerate_faces",
    "duplicate_faces",
    "nonmanifold_edges",
    "nonmanifold_edge_endpoints",
    "multifan_vertices",
    "boundary_edges",
)
_SHOWN_AT_FIRST = 12_000
_FRAMING_SAMPLE = 100_000
# The first view ignores far vertices if they make the sphere this many times as wide as 95 % of them.
_FAR_OUT = 4.0


@dataclass(frozen=True, eq=False)
class Layer:
    """The elements of one kind: their numbers in the audit (n,) and their vertices (n, 1 | 2 | 3), integers.

    An edge's number is its place in the order of vertex pairs.
    """

    style: Style
    numbers: NDArray[Any]
    vertices: NDArray[Any]

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass(frozen=True)
class SizeClass:
    """The components of `low` to `high` faces, both included, and their colour."""

    low: int
    high: int | None
    color: tuple[int, int, int]
    components: int


@dataclass(frozen=True, eq=False)
class ViewModel:
    """A mesh and everything that can be shown of it.

    Positions are moved and scaled so that what the first view frames is the unit sphere: float32 is then
    precise enough for any georeferenced mesh, and nothing overflows. A stored position is
    ``center + scale * point``; a vertex that is not `drawable` is at the origin, and no drawn face uses it.
    `face_component` is 0 in the largest component and -1 in repeated-index rows; `sizes` are the faces of
    each component, descending; `layers` are by kind, in the legend's order.
    """

    name: str
    method: str | None
    up: str
    audit: Audit
    analysis: Analysis
    points: NDArray[np.float32]
    drawable: NDArray[np.bool_]
    center: NDArray[np.float64]
    scale: float
    faces: NDArray[Any]
    drawn: NDArray[np.bool_]
    colors: Colors | None
    layers: dict[str, Layer]
    face_component: NDArray[Any]
    sizes: NDArray[Any]
    notes: tuple[str, ...] = ()
    skin: Skin | None = None

    @property
    def soup(self) -> bool:
        """Whether no vertex is used by two faces, and there are at least two faces."""
        return self.audit.topology == "triangle_soup" and len(self.faces) > 1

    @property
    def extent(self) -> float:
        """Distance from the origin to the farthest point, in drawn units."""
        return float(np.sqrt((self.points.astype(np.float64) ** 2).sum(axis=1).max(initial=0.0)))

    def finite(self, vertices: NDArray[Any]) -> NDArray[np.bool_]:
        """Return whether all of an element's vertices (n, k) can be drawn."""
        return np.asarray(self.drawable[vertices].all(axis=1))

    def shown_by_default(self) -> set[str]:
        """Return the kinds that are on at first: the worst, as many as one can tell apart from afar.

        The boundary of a soup, where every edge is one, is never among them.
        """
        shown: set[str] = set()
        total = 0
        for kind in _WORST_FIRST if _WORST_FIRST[0] in self.layers else self.layers:
            count = len(self.layers[kind])
            if count == 0 or (self.soup and kind == "boundary_edges"):
                continue
            total += count
            if shown and total > _SHOWN_AT_FIRST:
                break
            shown.add(kind)
        return shown

    def positions(self, kind: str, *, component: int | None = None) -> NDArray[np.float32]:
        """Return the corners (n, k, 3) of a layer's drawable elements, of one component if asked for."""
        return np.asarray(self.points[self.layers[kind].vertices[self.rows(kind, component)]])

    def rows(self, kind: str, component: int | None = None) -> NDArray[Any]:
        """Return which rows of a layer can be drawn: finite, and with `component` only that one's."""
        layer = self.layers[kind]
        keep = self.finite(layer.vertices)
        if component is not None:
            keep &= self._belongs(layer, component)
        return np.flatnonzero(keep)

    def _belongs(self, layer: Layer, component: int) -> NDArray[np.bool_]:
        inside = self.face_component == component
        if layer.style.of == "face":
            return np.asarray(inside[layer.numbers])
        if layer.style.of == "edge":
            # All faces at an edge are of one component: any of them tells.
            mesh = self.analysis.mesh
            return np.asarray(inside[mesh.edge_halfedges[mesh.edge_offsets[layer.numbers]] // 3])
        marked = np.zeros(len(self.points), bool)
        marked[self.faces[inside]] = True
        return np.asarray(marked[layer.numbers])

    def faces_of(self, component: int | None) -> NDArray[Any]:
        """Return the numbers of the faces to draw, of one component or all."""
        return np.flatnonzero(
            self.drawn if component is None else self.drawn & (self.face_component == component)
        )

    def _class_of_components(self) -> NDArray[np.uint8]:
        lows = np.array([low for low, _, _ in SIZE_CLASSES])
        found = np.searchsorted(lows, self.sizes, "right").astype(np.uint8)
        found[:1] = 0
        return found

    def size_class_of_faces(self) -> NDArray[np.uint8]:
        """Return for each face (F,) 0 in the largest component, else 1 + the place in SIZE_CLASSES."""
        # The last entry is what -1, a repeated-index row, looks up; it has no area to see.
        return np.asarray(np.append(self._class_of_components(), np.uint8(0))[self.face_component])

    def component_colors(self) -> NDArray[np.uint8]:
        """Return a colour for each face (F, 3): neutral in the largest component, else by size."""
        table = np.array([NEUTRAL, *(color for _, _, color in SIZE_CLASSES)], np.uint8)
        return np.asarray(table[self.size_class_of_faces()])

    def size_classes(self) -> list[SizeClass]:
        """Return the classes of all components but the largest, smallest first; empty ones are left out."""
        of_component = self._class_of_components()
        classes = []
        for place, (low, high, color) in enumerate(SIZE_CLASSES, 1):
            chosen = self.sizes[of_component == place]
            if len(chosen):
                classes.append(SizeClass(low, high, color, len(chosen)))
        return classes


def build_model(mesh: ViewedMesh, audit: Audit, analysis: Analysis) -> ViewModel:
    """Return what is to be shown of `mesh`, of which `audit_arrays` made `audit` and `analysis`.

    O(V + F) time beyond the audit's; about 12 V + 17 F bytes and the overlays beyond what the audit holds.
    """
    from msb.topology.elements import find_elements

    elements = find_elements(analysis)
    drawable = np.isfinite(analysis.vertices).all(axis=1)
    center, scale, cropped = framing(analysis.vertices, drawable & analysis.referenced)
    points = np.zeros(analysis.vertices.shape, np.float32)
    with np.errstate(over="ignore"):
        points[drawable] = (analysis.vertices[drawable].astype(np.float64) - center) / scale
    drawable &= np.isfinite(points).all(axis=1)
    points[~drawable] = 0
    faces = analysis.mesh.faces
    sizes = np.sort(analysis.components.sizes)[::-1]
    layers = _layers(analysis, {group.kind: group for group in elements.groups})
    model = ViewModel(
        name=mesh.name,
        method=mesh.method,
        up=known_up(mesh.up, mesh.method),
        audit=audit,
        analysis=analysis,
        points=points,
        drawable=drawable,
        center=center,
        scale=scale,
        faces=faces,
        drawn=drawable[faces].all(axis=1) if len(faces) else np.zeros(0, bool),
        colors=mesh.colors,
        layers=layers,
        face_component=elements.face_component,
        sizes=sizes,
        skin=mesh.skin,
    )
    return replace(model, notes=(*mesh.notes, *_notes(model), *([cropped] if cropped else [])))


def _layers(analysis: Analysis, groups: dict[str, Any]) -> dict[str, Layer]:
    mesh = analysis.mesh
    layers = {}
    for kind, style in STYLES.items():
        if kind == "degenerate_faces":  # two counts of the audit, one look
            both = [groups["repeated_index_faces"], groups["zero_area_faces"]]
            numbers = np.sort(np.concatenate([group.numbers for group in both]))
            vertices = mesh.faces[numbers]
        else:
            numbers, vertices = groups[kind].numbers, groups[kind].vertices
        layers[kind] = Layer(style, numbers, vertices)
    return layers


def framing(vertices: NDArray[Any], use: NDArray[np.bool_]) -> tuple[NDArray[np.float64], float, str | None]:
    """Return centre and radius of the sphere to look at, and what to say if it is not all of the mesh.

    Only the rows of `vertices` (V, 3) where `use` (V,) is true count; their centre is in their own units.
    It is the bounding sphere of the box, unless a few far vertices, such as outdoor backgrounds, make it many
    times as wide as the part that holds nearly all of the mesh.
    """
    rows = np.flatnonzero(use)
    if len(rows) == 0:
        return np.zeros(3), 1.0, None
    seen = np.asarray(vertices[rows], np.float64)
    low, high = seen.min(axis=0), seen.max(axis=0)
    center = low / 2 + high / 2
    radius = _largest_distance(seen, center)
    sample = seen[:: max(len(seen) // _FRAMING_SAMPLE, 1)]
    middle = np.median(sample, axis=0)
    with np.errstate(over="ignore"):
        distance = np.abs(sample - middle).max(axis=1)
    near = sample[distance <= np.quantile(distance, 0.95)]
    inner = _largest_distance(near, middle)
    if len(near) > 3 and inner > 0 and radius > _FAR_OUT * inner:
        outside = int(np.count_nonzero(np.abs(seen - middle).max(axis=1) > inner))
        text = f"{outside:,} far vertices lie outside the first view; Home shows 95 % of the vertices."
        return middle, 1.1 * inner, text
    return center, radius if radius > 0 else 1.0, None


def _largest_distance(points: NDArray[np.float64], center: NDArray[np.float64]) -> float:
    with np.errstate(over="ignore"):
        away = np.abs(points - center)
    scale = float(away.max(initial=0.0))
    if not 0 < scale < np.inf:  # all in one point, or further apart than float64 can say
        return 0.0 if scale == 0 else float(np.finfo(np.float64).max) / 4
    return scale * float(np.sqrt(((away / scale) ** 2).sum(axis=1).max()))


def _notes(model: ViewModel) -> list[str]:
    notes = []
    hidden = int(np.count_nonzero(~model.drawn))
    if len(model.faces) == 0 or not model.drawn.any():
        notes.append(EMPTY_NOTE)
    elif model.soup:
        notes.append(SOUP_NOTE)
    elif model.audit.verdict == "ok":
        notes.append(CLEAN_NOTE)
    if hidden:
        faces = "face" if hidden == 1 else "faces"
        notes.append(f"Not drawn: {hidden:,} {faces} with a corner that is not finite.")
    return notes
