"""The data of the topology viewer as arrays. This module needs neither VTK nor a display."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import known_up
from msb.topology import Audit
from msb.topology.analysis import Analysis
from msb.topology.seams import Seams
from msb_viewers.palette import NEUTRAL, SIZE_CLASSES, STYLES, Style
from msb_viewers.viewed_mesh import Colors, Skin, ViewedMesh, find_seam_edges

SOUP_NOTE = (
    "Triangle soup: the triangles share no vertices, so every edge is a boundary edge. Boundary edges are "
    "not drawn."
)
CLEAN_NOTE = "No defects: closed, manifold, consistently wound."
EMPTY_NOTE = "The mesh has no faces to draw."
# Layers sorted by severity. The most severe layer comes first.
_WORST_FIRST = (
    "degenerate_faces",
    "duplicate_faces",
    "nonmanifold_edges",
    "nonmanifold_edge_endpoints",
    "multifan_vertices",
    "boundary_edges",
)
# Maximum number of elements that are visible at first, over all layers. If more elements are visible, the
# view is hard to read.
_VISIBLE_AT_FIRST = 12_000
# Number of vertices that are sampled for the first view.
_FRAMING_SAMPLE = 100_000
# Maximum ratio of the radii of two spheres. The first sphere contains all vertices, and the second sphere 95
# % of the vertices. If the ratio is larger, the first view leaves out distant vertices.
_FAR_OUT = 4.0


@dataclass(frozen=True, eq=False)
class Layer:
    """The elements of one kind. The arrays contain the elements' indices in the audit (n,) and their vertices
    (n, 1 | 2 | 3), both integers.

    Edges are indexed in the order of their vertex pairs.
    """

    style: Style
    numbers: NDArray[Any]
    vertices: NDArray[Any]

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass(frozen=True)
class SizeClass:
    """The number of components that have `low` to `high` faces (inclusive), and their colour."""

    low: int
    high: int | None
    color: tuple[int, int, int]
    components: int


@dataclass(frozen=True, eq=False)
class ViewModel:
    """A mesh, its audit, and all data that a view can show.

    `points` (V, 3) are in view units. The stored position is ``center + scale * point``, and the first view
    shows the unit sphere. float32 is then precise enough for georeferenced meshes, and cannot overflow. A
    vertex is not `drawable` if its coordinates are not finite. A vertex that is not drawable is placed at the
    origin, and no face in `drawn` uses it. `face_component` (F,) is 0 in the largest component, and -1 for
    faces that list a vertex twice. `sizes` are the numbers of faces of the components in descending order.
    `layers` maps kinds to layers, in the order of the legend.
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
    seams: Seams | None = None

    @property
    def soup(self) -> bool:
        """Whether the mesh has at least two faces and no two faces share a vertex."""
        return self.audit.judged.topology == "triangle_soup" and len(self.faces) > 1

    def row_in_file(self, vertex: int) -> int:
        """Return the index of a vertex in the file.

        A vertex that was merged at seams has several indices. If the vertex has several indices, the function
        returns the first index.
        """
        return vertex if self.seams is None else int(self.seams.first[vertex])

    def vertex_of_row(self, row: int) -> int | None:
        """Return the vertex that is stored in a row of the file.

        If the file has no row with this index, return None.
        """
        rows = np.arange(len(self.points)) if self.seams is None else self.seams.number
        return int(rows[row]) if row < len(rows) else None

    @property
    def extent(self) -> float:
        """Distance from the origin to the farthest point in view units."""
        return float(np.sqrt((self.points.astype(np.float64) ** 2).sum(axis=1).max(initial=0.0)))

    def finite(self, vertices: NDArray[Any]) -> NDArray[np.bool_]:
        """Return a mask (n,) of elements whose `vertices` (n, k) can all be drawn."""
        return np.asarray(self.drawable[vertices].all(axis=1))

    def default_layers(self) -> set[str]:
        """Return the layers that are visible at first: the most severe layers, up to a total number of
        elements.

        In a triangle soup all edges are boundary edges, which are hidden at first.
        """
        visible: set[str] = set()
        total = 0
        for kind in _WORST_FIRST if _WORST_FIRST[0] in self.layers else self.layers:
            count = len(self.layers[kind])
            if count == 0 or (self.soup and kind == "boundary_edges"):
                continue
            total += count
            if visible and total > _VISIBLE_AT_FIRST:
                break
            visible.add(kind)
        return visible

    def positions(self, kind: str, *, component: int | None = None) -> NDArray[np.float32]:
        """Return the vertex positions (n, k, 3) of the elements of a layer that can be drawn.

        `component` selects one component. None selects all components.
        """
        return np.asarray(self.points[self.layers[kind].vertices[self.rows(kind, component)]])

    def rows(self, kind: str, component: int | None = None) -> NDArray[Any]:
        """Return the indices (n,) of a layer's drawable elements in all components or in one component."""
        layer = self.layers[kind]
        keep = self.finite(layer.vertices)
        if component is not None:
            keep &= self._in_component(layer, component)
        return np.flatnonzero(keep)

    def _in_component(self, layer: Layer, component: int) -> NDArray[np.bool_]:
        """Return a mask (n,) of the elements of a layer that belong to a component."""
        inside = self.face_component == component
        if layer.style.of == "face":
            return np.asarray(inside[layer.numbers])
        if layer.style.of == "edge":
            # All faces at an edge belong to the same component. Use the first face of the edge.
            mesh = self.analysis.mesh
            return np.asarray(inside[mesh.edge_halfedges[mesh.edge_offsets[layer.numbers]] // 3])
        marked = np.zeros(len(self.points), bool)
        marked[self.faces[inside]] = True
        return np.asarray(marked[layer.numbers])

    def faces_of(self, component: int | None) -> NDArray[Any]:
        """Return the indices of the faces to draw. The faces belong to one component or to all components."""
        return np.flatnonzero(
            self.drawn if component is None else self.drawn & (self.face_component == component)
        )

    def _class_of_components(self) -> NDArray[np.uint8]:
        """Return the class of each component: 0 for the largest, otherwise 1 + its index in SIZE_CLASSES."""
        lows = np.array([low for low, _, _ in SIZE_CLASSES])
        classes = np.searchsorted(lows, self.sizes, "right").astype(np.uint8)
        classes[:1] = 0
        return classes

    def size_class_of_faces(self) -> NDArray[np.uint8]:
        """Return the index of the size class for each face (F,), as in `_class_of_components`."""
        # Faces that list a vertex twice have the component -1, which selects the last entry. They are
        # invisible.
        return np.asarray(np.append(self._class_of_components(), np.uint8(0))[self.face_component])

    def component_colors(self) -> NDArray[np.uint8]:
        """Return a colour for each face (F, 3): grey, or the colour of the size class."""
        table = np.array([NEUTRAL, *(color for _, _, color in SIZE_CLASSES)], np.uint8)
        return np.asarray(table[self.size_class_of_faces()])

    def size_classes(self) -> list[SizeClass]:
        """Return the size classes of all components except the largest, in ascending order.

        Empty size classes are omitted.
        """
        of_component = self._class_of_components()
        classes = []
        for place, (low, high, color) in enumerate(SIZE_CLASSES, 1):
            count = int(np.count_nonzero(of_component == place))
            if count:
                classes.append(SizeClass(low, high, color, count))
        return classes


def build_model(
    mesh: ViewedMesh, audit: Audit, analysis: Analysis, stored: Analysis | None = None
) -> ViewModel:
    """Return the data of a view of `mesh`. `audit` and `analysis` are the results of `audit_arrays`.

    If the seams of `mesh` are merged (`merge_seams`), `stored` is the analysis of the mesh in the file.

    The function takes O(V + F) time, and about 12 V + 17 F bytes in addition to the audit and the layers.
    """
    from msb.topology.elements import ElementGroup, find_elements

    elements = find_elements(analysis)
    drawable = np.isfinite(analysis.vertices).all(axis=1)
    # Transform the positions to view units, (V, 3) float32.
    center, scale, cropped = frame_vertices(analysis.vertices, drawable & analysis.referenced)
    points = np.zeros(analysis.vertices.shape, np.float32)
    with np.errstate(over="ignore"):
        points[drawable] = (analysis.vertices[drawable].astype(np.float64) - center) / scale
    drawable &= np.isfinite(points).all(axis=1)
    points[~drawable] = 0
    faces = analysis.mesh.faces
    sizes = np.sort(analysis.components.sizes)[::-1]
    groups = {group.kind: group for group in elements.groups}
    torn = np.zeros(0, np.intp)
    if mesh.seams is not None and stored is not None:
        torn = find_seam_edges(mesh.seams, stored, analysis)
    groups["seam_edges"] = ElementGroup("seam_edges", torn, analysis.mesh.edge_vertices[torn])
    layers = _layers(analysis, groups)
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
        seams=mesh.seams,
    )
    return replace(model, notes=(*mesh.notes, *_notes(model), *([cropped] if cropped else [])))


def _layers(analysis: Analysis, groups: dict[str, Any]) -> dict[str, Layer]:
    """Return the layers for the audit's groups of elements."""
    mesh = analysis.mesh
    layers = {}
    for kind, style in STYLES.items():
        if kind == "degenerate_faces":  # this layer combines two groups of the audit
            both = [groups["repeated_index_faces"], groups["zero_area_faces"]]
            numbers = np.sort(np.concatenate([group.numbers for group in both]))
            vertices = mesh.faces[numbers]
        else:
            numbers, vertices = groups[kind].numbers, groups[kind].vertices
        layers[kind] = Layer(style, numbers, vertices)
    return layers


def frame_vertices(
    vertices: NDArray[Any], use: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float, str | None]:
    """Return the centre and the radius of the sphere that the first view shows. If some vertices are outside
    the sphere, also return a note.

    The sphere is computed from the `vertices` (V, 3) for which `use` (V,) is true. Usually the sphere is
    centred in the bounding box of these vertices and contains all of them. A few distant vertices, such as an
    outdoor background, can make the sphere very large. If there are distant vertices, the sphere contains
    only 95 % of the vertices.
    """
    # Compute the sphere of all vertices.
    rows = np.flatnonzero(use)
    if len(rows) == 0:
        return np.zeros(3), 1.0, None
    used = np.asarray(vertices[rows], np.float64)
    low, high = used.min(axis=0), used.max(axis=0)
    center = low / 2 + high / 2
    radius = _largest_distance(used, center)
    # Compute a sphere around the median of a sample of vertices. The sphere contains 95 % of the sample.
    sample = used[:: max(len(used) // _FRAMING_SAMPLE, 1)]
    middle = np.median(sample, axis=0)
    with np.errstate(over="ignore"):
        distance = np.abs(sample - middle).max(axis=1)
    near = sample[distance <= np.quantile(distance, 0.95)]
    inner = _largest_distance(near, middle)
    if len(near) > 3 and inner > 0 and radius > _FAR_OUT * inner:
        outside = int(np.count_nonzero(np.abs(used - middle).max(axis=1) > inner))
        text = f"{outside:,} distant vertices are outside the first view, which shows 95 % of the vertices."
        return middle, 1.1 * inner, text
    return center, radius if radius > 0 else 1.0, None


def _largest_distance(points: NDArray[np.float64], center: NDArray[np.float64]) -> float:
    """Without overflow, return the largest distance of points (n, 3) from `center`."""
    with np.errstate(over="ignore"):
        away = np.abs(points - center)
    scale = float(away.max(initial=0.0))
    if not 0 < scale < np.inf:  # all points are equal, or the distance overflows
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
    if model.seams is not None:
        notes.append(f"Vertices are merged at seams: the file has {model.audit.counts.vertices:,} vertices.")
    if hidden:
        faces = "face" if hidden == 1 else "faces"
        notes.append(f"Not drawn: {hidden:,} {faces} with coordinates that are not finite.")
    return notes
