"""Join faces in pairs at edges of more than two faces, and cut what is left over."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import corners_at_ends, group_corners
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of, next_in_face
from msb.topology.steps.change import Change
from msb.topology.steps.cut import split_vertices
from msb.topology.steps.sides import find_sides, sides_of_faces, spanning_tree

# How much a difference of black and white counts, beside a fold by 180 degrees, which counts 1.
COLOR_WEIGHT = 0.25
# The most faces of an edge that are compared all with all; of more, those half way round are paired.
MOST_COMPARED = 16
# Number of edges looked at together.
_CHUNK = 1 << 16


def pair(
    points: NDArray[Any],
    faces: NDArray[Any],
    *,
    vertex_colors: NDArray[Any] | None = None,
    face_colors: NDArray[Any] | None = None,
    color_weight: float = COLOR_WEIGHT,
) -> Change:
    """Make a mesh manifold by copies of vertices at the end, so that faces which continue each other stay
    together.

    Colours in [0, 1] are those of vertices (V, c), of which the ones opposite to an edge are compared, or of
    faces (F, c).

    1. Two faces at an edge cost (1 + cos a) / 2, a the angle between them (0 if flat, 1 if folded), plus
       `color_weight` times the distance of their colours over that of black and white. At each edge of more
       than two faces the cheapest two are joined, then the cheapest two of the rest, and so on.
    2. Joining must leave a consistent winding possible: of the joints between parts of the surface a
       spanning forest of least cost is kept, and the others where they agree with it.
    3. Where walks around both ends of an edge lead from one pair to another, four faces would still share
       the edge: these pairs are cut. Cutting makes fans smaller, never larger, so no new such place arises.

    These take O(F log F) time. A manifold mesh is not changed.
    """
    mesh = build_half_edges(faces, len(points))
    one, other = mesh.two_face_halfedges
    if (mesh.multiplicity > 2).any():
        joined, cost = _flattest_pairs(mesh, points, vertex_colors, face_colors, color_weight)
        joined = joined[_windable(mesh, joined, cost)]
        joined = joined[_apart(mesh, joined)]
        one, other = np.concatenate([one, joined[:, 0]]), np.concatenate([other, joined[:, 1]])
    return split_vertices(mesh, one, other)


def _flattest_pairs(
    mesh: HalfEdgeMesh,
    points: NDArray[Any],
    vertex_colors: NDArray[Any] | None,
    face_colors: NDArray[Any] | None,
    color_weight: float,
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Return the (n, 2) half-edges joined at crowded edges, and what each pair costs."""
    pairs, costs = [], []
    for group in _crowded_groups(mesh):
        sides, along = _directions(mesh, points, group)
        if group.shape[1] > MOST_COMPARED:
            chosen = _half_way_round(sides, along)
            one, other = (np.take_along_axis(sides, chosen[..., end, None], axis=1) for end in (0, 1))
            cost = (1 + np.einsum("npx,npx->np", one, other)) / 2
        else:
            table = (1 + np.einsum("nix,njx->nij", sides, sides)) / 2
            for colors, rows in ((vertex_colors, _apexes(mesh, group)), (face_colors, face_of(group))):
                if colors is not None:
                    table += color_weight * _distances(colors[rows])
            chosen, cost = _cheapest(table)
        row = np.arange(len(group))[:, None]
        pairs.append(np.stack([group[row, chosen[..., 0]], group[row, chosen[..., 1]]], -1).reshape(-1, 2))
        costs.append(cost.reshape(-1))
    return np.concatenate(pairs), np.concatenate(costs)


def _crowded_groups(mesh: HalfEdgeMesh) -> Iterator[NDArray[Any]]:
    """Yield (n, k) half-edges of edges with k > 2 faces, a bounded number of edges at a time."""
    for size in np.unique(mesh.multiplicity[mesh.multiplicity > 2]):
        edges = np.flatnonzero(mesh.multiplicity == size)
        chunk = max(_CHUNK // min(int(size), MOST_COMPARED), 1)
        for start in range(0, len(edges), chunk):
            place = mesh.edge_offsets[edges[start : start + chunk], None] + np.arange(size)
            yield mesh.edge_halfedges[place]


def _apexes(mesh: HalfEdgeMesh, group: NDArray[Any]) -> NDArray[Any]:
    """Return the vertex opposite to each half-edge."""
    return np.asarray(mesh.origin[next_in_face(next_in_face(group))])


def _directions(
    mesh: HalfEdgeMesh, points: NDArray[Any], group: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (n, k, 3) unit vectors in each face at a right angle to its edge, and (n, 3) along it.

    They are zero where a face has no height or an edge no length.
    """
    ends = np.sort(np.stack([mesh.origin[group[:, 0]], mesh.origin[next_in_face(group[:, 0])]]), axis=0)
    low, high = points[ends].astype(np.float64)
    along = _unit(high - low)
    out = points[_apexes(mesh, group)].astype(np.float64) - low[:, None]
    size = np.linalg.norm(out, axis=-1, keepdims=True)
    out -= np.einsum("nkx,nx->nk", out, along)[..., None] * along[:, None]
    out[np.linalg.norm(out, axis=-1) <= 1e-12 * size[..., 0]] = 0  # what rounding leaves of no height
    return _unit(out), along


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    largest = np.abs(vectors).max(axis=-1, keepdims=True)
    vectors = np.divide(vectors, largest, out=np.zeros_like(vectors), where=largest > 0)
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, norm, out=np.zeros_like(vectors), where=norm > 0))


def _distances(colors: NDArray[Any]) -> NDArray[np.float64]:
    """Return (n, k, k) distances of (n, k, c) colours, over the distance of black and white."""
    difference = colors[:, :, None].astype(np.float64) - colors[:, None]
    return np.asarray(np.linalg.norm(difference, axis=-1) / np.sqrt(colors.shape[-1]))


def _cheapest(table: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Return of (n, k, k) costs the (n, k // 2, 2) pairs by greed, and what they cost; ties to the first."""
    count, size, _ = table.shape
    first, second = np.triu_indices(size, 1)
    left = table[:, first, second]
    row = np.arange(count)
    chosen = np.zeros((count, size // 2, 2), np.intp)
    cost = np.zeros((count, size // 2))
    for turn in range(size // 2):
        best = np.argmin(left, axis=1)
        cost[:, turn] = left[row, best]
        chosen[:, turn, 0], chosen[:, turn, 1] = first[best], second[best]
        for end in (first[best], second[best]):
            left[(first == end[:, None]) | (second == end[:, None])] = np.inf
    return chosen, cost


def _half_way_round(sides: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[Any]:
    """Return the (n, k // 2, 2) pairs of faces half a turn apart in the order around each edge."""
    count, size, _ = sides.shape
    axis = np.zeros_like(along)
    axis[np.arange(count), np.abs(along).argmin(axis=1)] = 1
    right = np.cross(along, axis)
    up = np.cross(along, right)
    angle = np.arctan2(np.einsum("nkx,nx->nk", sides, up), np.einsum("nkx,nx->nk", sides, right))
    order = np.argsort(angle, axis=1, kind="stable")
    half = size // 2
    return np.stack([order[:, :half], order[:, half : 2 * half]], axis=-1)


def _windable(mesh: HalfEdgeMesh, joined: NDArray[Any], cost: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which pairs to keep so that these can all be wound consistently, the cheap ones first."""
    sides = sides_of_faces(mesh)
    _, part = np.unique(sides.label, return_inverse=True)
    count = int(part.max(initial=-1)) + 1
    one, other = face_of(joined).T
    clash = mesh.origin[joined[:, 0]] == mesh.origin[joined[:, 1]]
    differ = clash ^ sides.other[one] ^ sides.other[other]
    one, other = part[one], part[other]
    between = np.flatnonzero(one != other)
    # More than 0, which would be no pair.
    tree = between[spanning_tree(count, one[between], other[between], 1.0 + cost[between])]
    turned = find_sides(count, one[tree], other[tree], differ[tree]).other
    return np.asarray((turned[one] ^ turned[other]) == differ)


def _apart(mesh: HalfEdgeMesh, joined: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which pairs leave no edge of more than two faces, when all vertices are split accordingly."""
    one, other = mesh.two_face_halfedges
    one, other = np.concatenate([one, joined[:, 0]]), np.concatenate([other, joined[:, 1]])
    _, group = group_corners(mesh, one, other)
    crowded = mesh.edge_halfedges[np.repeat(mesh.multiplicity > 2, mesh.multiplicity)]
    ends = np.stack([mesh.edge[crowded], *(group[corner] for corner in corners_at_ends(mesh, crowded))])
    order = np.lexsort(ends)
    differs = np.ones(len(order) + 1, bool)
    differs[1:-1] = (ends[:, order[1:]] != ends[:, order[:-1]]).any(axis=0)
    sizes = np.diff(np.flatnonzero(differs))
    alone = np.ones(mesh.faces.size, bool)
    alone[crowded[order]] = np.repeat(sizes <= 2, sizes)
    return np.asarray(alone[joined[:, 0]])
