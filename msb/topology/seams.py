"""Seams: vertices that a file had to store more than once, because each row has one texture coordinate.

The definition is in docs/definitions.md ("Seams"). What is doubled for another reason, such as normals or a
format without shared vertices, is no seam; whether a mesh would be closed without such doubles is told, too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.base.soup import is_soup
from msb.topology.components import label_components
from msb.topology.dispatch import find
from msb.topology.faces import names_vertex_twice
from msb.topology.findings import Counts, Findings
from msb.topology.weld import coincident_vertices, weld_vertices

# What a file doubles vertices for: "uv" (V, 2) and "color" (V, n), or by corner "corner_uv" (3F, 2) and
# "corner_color" (3F, n), and "face_texture" (F,) of faces.
Attributes = Mapping[str, NDArray[Any]]
SeamKind = Literal["texture", "color"]

# Welding and auditing again takes as long as the audit: larger meshes are not welded unasked.
MOST_FACES = 200_000


@dataclass(frozen=True, eq=False)
class Seams:
    """The vertices of a mesh without its seams.

    `first` (W,) is the first row of each, ascending, and `number` (V,) says which of them each row is. The
    `kind` is "texture" where the mesh has UVs, else "color".
    """

    first: NDArray[Any]
    number: NDArray[Any]
    kind: SeamKind

    @property
    def doubles(self) -> int:
        """Number of rows that repeat another at a seam."""
        return len(self.number) - len(self.first)

    def merged(self, faces: NDArray[Any]) -> NDArray[Any]:
        """Return `faces` by the merged vertices, in the type they have."""
        return np.asarray(self.number.astype(faces.dtype)[faces])


def seam_attributes(buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str]) -> dict[str, Any]:
    """Return those of an asset's buffers for whose sake a file doubles vertices: UVs and colours.

    What a model was trained to have at its vertices is not among them: its rows are its own, not a file's.
    """
    by = {"vertex": "", "corner": "corner_"}
    names = [name for name in ("uv", "color") if domains.get(name) in by]
    found = {f"{by[domains[name]]}{name}": buffers[name] for name in names}
    if "uv" in names and "face_texture" in buffers:  # files hold the faces of each texture apart
        found["face_texture"] = buffers["face_texture"]
    return found


def find_seams(points: NDArray[Any], faces: NDArray[Any], attributes: Attributes) -> Seams | None:
    """Return the seams of a mesh, or None if it has none.

    Two boundary edges in one place are one edge that was torn if UVs or colours differ at an end, or the
    textures of their faces: their ends are merged. Of more than two it is not known which belong together.
    The corners of a triangle soup may meet by chance. That seams alone made a mesh a soup is believed if most
    faces have a torn edge, and no edges in one place are alike. O(V log V) time, of which next to nothing
    where no two vertices coincide.
    """
    if not attributes or not len(faces):
        return None
    rows, set_of = coincident_vertices(points)
    if not len(rows):
        return None
    place = np.arange(len(points))
    place[rows] = rows[set_of]
    double = np.zeros(len(points), bool)
    double[rows] = True
    a, b, c = faces.T
    near = np.flatnonzero(double[a] | double[b] | double[c])
    near = near[~names_vertex_twice(faces[near])]
    if not len(near):
        return None
    held = [_by_corner(name, values, faces, near) for name, values in attributes.items()]
    edges, torn_faces, alike = _torn_edges(faces[near].astype(np.int64), place, double, held)
    if not len(edges):
        return None
    may_be_chance = (alike or 2 * torn_faces <= len(faces)) and is_soup(faces[near])
    if may_be_chance and is_soup(faces[~names_vertex_twice(faces)]):
        return None
    ends, node = np.unique(edges.reshape(-1), return_inverse=True)
    _, label = label_components(len(ends), *node.reshape(-1, 2).T)
    _, lowest = np.unique(label, return_index=True)  # `ends` ascend, so the first of each is the lowest
    labels = np.arange(len(points))
    labels[ends] = ends[lowest][label]
    is_first = labels == np.arange(len(points))
    number = (np.cumsum(is_first) - 1)[labels]
    kind: SeamKind = "texture" if {"uv", "corner_uv"} & set(attributes) else "color"
    return Seams(np.flatnonzero(is_first), number, kind)


def _by_corner(name: str, values: NDArray[Any], faces: NDArray[Any], chosen: NDArray[Any]) -> NDArray[Any]:
    """Return what the corners of the `chosen` faces have of an attribute, (3 n, k)."""
    if name == "face_texture":
        return np.repeat(values[chosen], 3)[:, None]
    held = values.reshape(len(faces), 3, -1)[chosen] if "corner" in name else values[faces[chosen]]
    return np.asarray(held.reshape(3 * len(chosen), -1))


def _torn_edges(
    faces: NDArray[np.int64], place: NDArray[Any], double: NDArray[np.bool_], held: list[NDArray[Any]]
) -> tuple[NDArray[np.int64], int, bool]:
    """Return the (n, 2) pairs of rows to be merged, at how many faces, and whether other edges coincide.

    Those are boundary edges in one place that are alike at both ends. `faces` are all proper ones with a
    vertex that is stored more than once, so all faces at an edge with such an end are among them; `held` has
    what their corners have.
    """
    corners = np.arange(faces.size).reshape(-1, 3)
    ends, ends_at = (
        np.stack([rows, np.roll(rows, -1, axis=1)], axis=-1).reshape(-1, 2) for rows in (faces, corners)
    )
    start, end = ends.T
    number = np.flatnonzero((double[start] | double[end]) & (place[start] != place[end]))
    ends = ends[number]
    low, high = np.minimum(*ends.T), np.maximum(*ends.T)
    _, first, faces_there = np.unique(low * len(place) + high, return_index=True, return_counts=True)
    first = first[faces_there == 1]
    rim, at = ends[first], ends_at[number[first]]
    # The end whose place has the lower number first, so that ends in one place stand in one column.
    there = place[rim]
    turned = (there[:, 0] > there[:, 1])[:, None]
    rim, at, there = (np.where(turned, rows[:, ::-1], rows) for rows in (rim, at, there))
    _, first, group, size = np.unique(
        there[:, 0] * len(place) + there[:, 1], return_index=True, return_inverse=True, return_counts=True
    )
    group = group.reshape(-1)
    beside = first[group]
    differs = np.zeros(len(rim), bool)
    for values in held:
        differs |= (values[at] != values[at[beside]]).any(axis=(1, 2))
    differs = np.bincount(group, differs, len(size))[group] > 0
    own = at[:, 0] // 3 == at[beside, 0] // 3  # both sides of a sliver: a face is not folded onto itself
    torn = differs & (size[group] == 2) & (np.bincount(group, own)[group] < 2)
    alike = bool(((size[group] > 1) & ~differs).any())
    pairs = np.stack([rim, rim[beside]], axis=-1)[torn].reshape(-1, 2)
    return pairs[pairs[:, 0] != pairs[:, 1]], len(np.unique(at[torn] // 3)), alike


def is_closed(counts: Counts) -> bool:
    """Return whether a mesh has faces and is closed, manifold and consistently wound, with no face twice."""
    return counts.faces > counts.repeated_index_faces and not (
        counts.boundary_edges
        or counts.nonmanifold_vertices
        or counts.inconsistent_winding_edges
        or counts.duplicate_faces
    )


def closes_once_merged(findings: Findings, points: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether the exact weld closes an open mesh of at most `MOST_FACES` faces; else False.

    `findings` are those of the mesh as stored.
    """
    counts = findings.counts
    if not counts.boundary_edges or counts.faces > MOST_FACES:
        return False
    # What welding does not mend, and what it would mend everywhere: nearly all meshes end here.
    if counts.nonmanifold_edges or counts.inconsistent_winding_edges or counts.duplicate_faces:
        return False
    if not _all_coincide([edge for _, edge in findings.first["boundary_edges"]], points):
        return False
    return is_closed(find(*weld_vertices(points, faces, "exact"))[0].counts)


def _all_coincide(edges: list[tuple[int, ...]], points: NDArray[Any]) -> bool:
    """Return whether an end of each edge has the float32 coordinates of another vertex.

    A boundary edge that a weld removes has such an end: had both ends none, the edge would stay as it is.
    """
    with np.errstate(over="ignore"):
        places = points.astype(np.float32)
    return all(
        any(np.count_nonzero((places == places[vertex]).all(axis=1)) > 1 for vertex in edge) for edge in edges
    )
