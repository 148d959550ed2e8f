"""Seams: vertices that a file stores more than once because the file format demands this.

In most formats a vertex row has a single UV coordinate, colour and normal. A triangle list shares no vertices
at all. The page docs/definitions.md ("Seams") has the definition. Vertices duplicated for another reason are
not seams. For such vertices, `closes_once_merged` tells whether an exact weld would close the mesh.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.base.seam_keys import SEAM_KEY, TRIANGLE_LIST
from msb.base.soup import is_soup
from msb.topology.components import label_components
from msb.topology.dispatch import find_findings
from msb.topology.faces import names_vertex_twice
from msb.topology.findings import Counts, Findings
from msb.topology.verdict import helps
from msb.topology.weld import Weld, find_coincident_vertices, merge_coincident, weld_vertices

# Names of attributes that make a file duplicate vertices. Attributes by vertex: "uv" (V, 2), "color" (V, n)
# and "seam_key" (V,). Attributes by corner: "corner_uv" (3F, 2), "corner_color" (3F, n) and
# "corner_seam_key" (3F,). Attribute by face: "face_texture" (F,). The attribute "seam_key" is a hash of all
# attributes that the reader ignores, such as normals and tangents. The entry TRIANGLE_LIST means that a
# triangle soup may be a surface without shared vertices. The value of the entry TRIANGLE_LIST does not
# matter.
Attributes = Mapping[str, NDArray[Any]]
SeamKind = Literal["texture", "color", "normal", "format"]
# If more than this share of the edges coincide with another edge, a triangle soup counts as a surface without
# shared vertices. In a trained triangle soup, corners coincide by chance only.
_COINCIDING = 0.5
# Two faces fold onto each other if the cosine of the angle between their normals is below this limit. Angles
# within 0.08 degrees of 180 degrees are below the limit. Such faces are the two sides of a thin sheet, and
# the edge between the faces is not a seam.
_FOLDED = -0.999999

# Largest rounding difference of two vertices, relative to the largest coordinate. The value is four units in
# the last place of float32. The second value is the largest difference relative to the size of the mesh.
_ROUNDING, _MOST_ROUNDING = 2.0**-21, 1e-5

# If a mesh has at most this number of faces, the audit tests an exact weld even without --weld. Testing an
# exact weld takes about as long as the audit itself.
MOST_FACES = 200_000


@dataclass(frozen=True, eq=False)
class Seams:
    """The vertices of a mesh after its seams are merged.

    Attributes
    ----------
    first : (W,) integers
        The first row of each merged vertex, ascending.
    number : (V,) integers
        The merged vertex of each row.
    kind : {"texture", "color", "normal", "format"}
        The kind is "format" for a triangle list. The kind is "normal" if the copies differ only in ignored
        attributes, such as normals. Otherwise, the kind is "texture" if the mesh has UVs, and "color" if the
        mesh has no UVs.
    unexplained : bool
        Whether some vertices are duplicated only for ignored attributes. A renderer needs the duplicates only
        for these attributes.
    """

    first: NDArray[Any]
    number: NDArray[Any]
    kind: SeamKind
    unexplained: bool = False

    @property
    def doubles(self) -> int:
        """Number of vertex rows that duplicate another row at a seam."""
        return len(self.number) - len(self.first)

    def merged(self, faces: NDArray[Any]) -> NDArray[Any]:
        """Return `faces` (F, 3) with merged vertex indices, in the same integer type."""
        return np.asarray(self.number.astype(faces.dtype)[faces])


def seam_attributes(
    buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str], *, triangle_list: bool = False
) -> dict[str, Any]:
    """Return the attributes of an asset for which files duplicate vertices: UVs, colours and seam keys.

    Trained vertex attributes are not included, because their rows belong to the model, not to a file format.
    The argument `triangle_list` adds the entry TRIANGLE_LIST, for meshes that are not trained.
    """
    prefix = {"vertex": "", "corner": "corner_"}
    names = [name for name in ("uv", "color", SEAM_KEY) if domains.get(name) in prefix]
    attributes = {f"{prefix[domains[name]]}{name}": buffers[name] for name in names}
    if "uv" in names and "face_texture" in buffers:  # Files store the faces of each texture separately.
        attributes["face_texture"] = buffers["face_texture"]
    return {**attributes, TRIANGLE_LIST: np.zeros(0)} if triangle_list else attributes


def find_seams(points: NDArray[Any], faces: NDArray[Any], attributes: Attributes) -> Seams | None:
    """Return the seams of a mesh, or None for a mesh without seams.

    A torn edge is a pair of coincident boundary edges. At an end, the attributes of the two edges differ, or
    the faces of the edges have different textures. The end vertices of a torn edge are merged. Three or more
    coincident boundary edges are not merged, because their pairing is ambiguous.

    A triangle soup has seams only under two conditions. First, more than half of the faces have a torn edge.
    Second, no coincident boundary edges have equal attributes. With TRIANGLE_LIST, all coincident vertices of
    a triangle soup are merged. The condition is that more than half of the edges coincide with another edge.
    The search takes O(V log V) time, and much less if no two vertices coincide.
    """
    if not attributes or not len(faces):
        return None
    rows, set_of = find_coincident_vertices(points)
    if not len(rows):
        return None
    # `place[v]` is the index of the first vertex with the coordinates of vertex v. `double[v]` states whether
    # another vertex has the coordinates of vertex v.
    place = np.arange(len(points))
    place[rows] = rows[set_of]
    double = np.zeros(len(points), bool)
    double[rows] = True
    values = {name: array for name, array in attributes.items() if name != TRIANGLE_LIST}
    seams = _merge_torn_edges(points, faces, values, place, double) if values else None
    if seams is None and TRIANGLE_LIST in attributes:
        seams = _merge_triangle_list(faces, place)
    return seams


def _merge_torn_edges(
    points: NDArray[Any],
    faces: NDArray[Any],
    attributes: Attributes,
    place: NDArray[Any],
    double: NDArray[np.bool_],
) -> Seams | None:
    """Return the seams between vertices with different attributes, as defined at `find_seams`."""
    # Only faces with a duplicated vertex can have a torn edge. Faces with a repeated index have no edges.
    a, b, c = faces.T
    near = np.flatnonzero(double[a] | double[b] | double[c])
    near = near[~names_vertex_twice(faces[near])]
    if not len(near):
        return None
    corner_values = {
        name: _spread_to_corners(name, values, faces, near) for name, values in attributes.items()
    }
    torn = _find_torn_edges(faces[near].astype(np.int64), points, place, double, corner_values)
    if not len(torn.pairs):
        return None
    may_be_chance = (torn.equal_edges or 2 * torn.faces <= len(faces)) and is_soup(faces[near])
    if may_be_chance and is_soup(faces[~names_vertex_twice(faces)]):
        return None
    # Connected vertex pairs form a group. Each group becomes one vertex, namely its lowest row.
    ends, node = np.unique(torn.pairs.reshape(-1), return_inverse=True)
    _, label = label_components(len(ends), *node.reshape(-1, 2).T)
    # `ends` are sorted, so the first entry of each label is the lowest row.
    _, lowest = np.unique(label, return_index=True)
    labels = np.arange(len(points))
    labels[ends] = ends[lowest][label]
    kind: SeamKind = "texture" if {"uv", "corner_uv"} & set(attributes) else "color"
    return _number_merged(labels, "normal" if torn.all_by_key else kind, torn.some_by_key)


def _merge_triangle_list(faces: NDArray[Any], place: NDArray[Any]) -> Seams | None:
    """Return the exact weld of a triangle soup.

    Return None if at most half of the edges coincide with another edge.
    """
    proper = faces[~names_vertex_twice(faces)]
    if not is_soup(proper):
        return None
    # Compute the share of the half-edges (3F,) that coincide with another half-edge.
    ends = place[proper]
    low, high = (pick(ends, np.roll(ends, -1, axis=1)).reshape(-1) for pick in (np.minimum, np.maximum))
    _, size = np.unique(low * len(place) + high, return_counts=True)
    if size[size > 1].sum() <= _COINCIDING * len(low):
        return None
    return _number_merged(place, "format", unexplained=True)


def _number_merged(labels: NDArray[Any], kind: SeamKind, unexplained: bool) -> Seams:
    """Return the seams that merge all vertices with equal labels.

    A label (V,) is the lowest vertex row of the group.
    """
    is_first = labels == np.arange(len(labels))
    number = (np.cumsum(is_first) - 1)[labels]
    return Seams(np.flatnonzero(is_first), number, kind, unexplained)


def _spread_to_corners(
    name: str, values: NDArray[Any], faces: NDArray[Any], rows: NDArray[Any]
) -> NDArray[Any]:
    """Return the attribute values (3 n, k) at the corners of the faces `rows` (n,)."""
    if name == "face_texture":
        return np.repeat(values[rows], 3)[:, None]
    corners = values.reshape(len(faces), 3, -1)[rows] if "corner" in name else values[faces[rows]]
    return np.asarray(corners.reshape(3 * len(rows), -1))


@dataclass(frozen=True, eq=False)
class _TornEdges:
    """The boundary edges that are torn by seams.

    The field `pairs` (n, 2) contains the vertex rows to merge. The field `faces` is the number of faces with
    a torn edge. The field `equal_edges` is true if two coincident boundary edges have equal attributes at
    both ends. The field `some_by_key` is true if some torn edges separate attributes that differ only in
    their seam keys. The field `all_by_key` is true if every torn edge separates attributes that differ only
    in their seam keys.
    """

    pairs: NDArray[np.int64]
    faces: int
    equal_edges: bool
    some_by_key: bool
    all_by_key: bool


def _find_torn_edges(
    faces: NDArray[np.int64],
    points: NDArray[Any],
    place: NDArray[Any],
    double: NDArray[np.bool_],
    corner_values: Mapping[str, NDArray[Any]],
) -> _TornEdges:
    """Find the boundary edges that are torn by seams.

    The argument `faces` (F, 3) must be all faces with a duplicated vertex and without a repeated index.
    `place[v]` is the index of the first vertex with the coordinates of vertex v. `double[v]` states whether
    another vertex has the coordinates of vertex v. Each array of `corner_values` holds an attribute (3F, k)
    at the corners of `faces`.
    """
    corners = np.arange(faces.size).reshape(-1, 3)
    ends, ends_at = (
        np.stack([rows, np.roll(rows, -1, axis=1)], axis=-1).reshape(-1, 2) for rows in (faces, corners)
    )
    # `ends` and `ends_at` (3F, 2) are the vertices and corners at both ends of each half-edge. Keep edges
    # that have a duplicated vertex. The two ends must have different positions.
    start, end = ends.T
    number = np.flatnonzero((double[start] | double[end]) & (place[start] != place[end]))
    ends = ends[number]
    # Boundary edges are vertex pairs that occur once.
    low, high = np.minimum(*ends.T), np.maximum(*ends.T)
    _, first, faces_there = np.unique(low * len(place) + high, return_index=True, return_counts=True)
    first = first[faces_there == 1]
    edges, corner = ends[first], ends_at[number[first]]
    # Order both ends by position, so that coincident edges have matching columns.
    spot = place[edges]
    swap = (spot[:, 0] > spot[:, 1])[:, None]
    edges, corner, spot = (np.where(swap, rows[:, ::-1], rows) for rows in (edges, corner, spot))
    # Group coincident boundary edges, and compare every edge with the first edge of its group.
    _, first, group, size = np.unique(
        spot[:, 0] * len(place) + spot[:, 1], return_index=True, return_inverse=True, return_counts=True
    )
    group = group.reshape(-1)
    other = first[group]
    # `differs[e]` is true if attributes other than the seam keys differ. `by_key[e]` is true if the two edges
    # differ only in their seam keys.
    differs, by_key = np.zeros(len(edges), bool), np.zeros(len(edges), bool)
    for name, values in corner_values.items():
        unequal = (values[corner] != values[corner[other]]).any(axis=(1, 2))
        if name.endswith(SEAM_KEY):
            by_key |= unequal
        else:
            differs |= unequal
    differs, by_key = (np.bincount(group, rows, len(size))[group] > 0 for rows in (differs, by_key))
    by_key &= ~differs
    if by_key.any():
        by_key &= ~_find_folds(faces, points, corner // 3, other)
    # Exclude two edges of a single thin face, because merging them would fold the face onto itself.
    same_face = corner[:, 0] // 3 == corner[other, 0] // 3
    torn = (differs | by_key) & (size[group] == 2) & (np.bincount(group, same_face)[group] < 2)
    equal_edges = bool(((size[group] > 1) & ~differs & ~by_key).any())
    pairs = np.stack([edges, edges[other]], axis=-1)[torn].reshape(-1, 2)
    some, every = bool(by_key[torn].any()), bool(by_key[torn].all())
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return _TornEdges(pairs, len(np.unique(corner[torn] // 3)), equal_edges, some, every)


def _find_folds(
    faces: NDArray[np.int64], points: NDArray[Any], face: NDArray[np.int64], other: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return a mask (E,) of the edges whose two faces fold onto each other, such as the two sides of a sheet.

    The columns of `face` (E, 2) hold the faces of each edge. The argument `other` (E,) contains, for each
    edge, the edge to compare.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        corners = points[faces].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
        opposite = (normals[face[:, 0]] * normals[face[other, 0]]).sum(axis=1) < _FOLDED
    # The first edge of a group was compared with itself, so mark both edges of each pair.
    folded = np.zeros(len(face), bool)
    folded[opposite] = folded[other[opposite]] = True
    return folded


def is_closed(counts: Counts) -> bool:
    """Return whether a mesh has faces, is closed, manifold and consistently wound, and repeats no face."""
    return counts.faces > counts.repeated_index_faces and not (
        counts.boundary_edges
        or counts.nonmanifold_vertices
        or counts.inconsistent_winding_edges
        or counts.duplicate_faces
    )


@dataclass(frozen=True)
class Merged:
    """The counts of a mesh after a weld, and the kind of the weld."""

    weld: Weld
    counts: Counts


def audit_merged(findings: Findings, points: NDArray[Any], faces: NDArray[Any]) -> Merged | None:
    """Return the counts after the weld that closes an open mesh.

    Return None for more than `MOST_FACES` faces. The argument `findings` describes the mesh as it is stored.
    An exact weld is tried first. If the exact weld does not close the mesh, vertices of boundary edges that
    differ by rounding are merged. The result is None as well if no vertices differ only by rounding.
    """
    counts = findings.counts
    if not counts.boundary_edges or counts.faces > MOST_FACES:
        return None
    exact = None
    if len(find_coincident_vertices(points)[0]):
        exact = Merged("exact", find_findings(*weld_vertices(points, faces, "exact"))[0].counts)
    if counts.all_apart or (exact is not None and helps(exact.counts, counts)):
        return exact
    near = _weld_rounded(points, faces)
    return near if near is not None and helps(near.counts, counts) else exact


def _weld_rounded(points: NDArray[Any], faces: NDArray[Any]) -> Merged | None:
    """Merge vertices of boundary edges that differ by rounding. Return the counts after this merge, or
    None."""
    # Boundary edges are vertex pairs that occur once.
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    edges, times = np.unique(ends.min(axis=1) * len(points) + ends.max(axis=1), return_counts=True)
    rim = np.unique(np.divmod(edges[times == 1], len(points)))
    rim = rim[np.isfinite(points[rim]).all(axis=1)]
    if not len(rim):
        return None
    places = points[rim].astype(np.float64)
    largest = np.abs(places).max()
    distance = float(f"{_ROUNDING * largest:.1e}")
    if not 0 < distance < _MOST_ROUNDING * np.ptp(places, axis=0).max():
        return None
    first, number = merge_coincident(points[rim], distance)
    if len(first) == len(rim):
        return None
    label = np.arange(len(points))
    label[rim] = rim[first][number]
    kept, renumbered = np.unique(label, return_inverse=True)
    merged = renumbered.reshape(-1)[faces].astype(faces.dtype)
    return Merged(distance, find_findings(points[kept], merged)[0].counts)
