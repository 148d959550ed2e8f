"""Join faces in pairs at edges with more than two faces, and cut the remaining faces."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.fans import find_end_corners, group_corners
from msb.topology.halfedge import HalfEdgeMesh, build_half_edges, face_of, next_in_face
from msb.topology.steps.change import Change
from msb.topology.steps.cut import split_vertices
from msb.topology.steps.sides import find_sides, find_sides_of_faces, find_spanning_tree

# Cost of the colour difference between black and white. The cost of a fold by 180 degrees is 1.
COLOR_WEIGHT = 0.25
# All faces at an edge are compared pairwise if there are at most this many faces. At edges with more faces,
# each face is paired with the face on the opposite side of the edge.
MOST_COMPARED = 16
# Number of edges per batch.
_CHUNK = 1 << 16


def pair(
    points: NDArray[Any],
    faces: NDArray[Any],
    *,
    vertex_colors: NDArray[Any] | None = None,
    face_colors: NDArray[Any] | None = None,
    color_weight: float = COLOR_WEIGHT,
) -> Change:
    """Make a mesh manifold by copying vertices. Faces that continue each other smoothly stay connected.

    Colours are in [0, 1], by vertex (V, c) or by face (F, c). Colours at vertices are compared at the two
    vertices opposite to the edge. Copies of vertices come last.

    1. Two faces at an edge have the joining cost (1 + cos a) / 2, where a is the angle between the faces. The
       cost is 0 for flat faces and 1 for folded faces. A colour difference adds `color_weight` times the
       distance of the colours. The distance between black and white is 1. At each edge with more than two
       faces, the cheapest pair of faces is joined first, then the cheapest pair of the remaining faces.
    2. Joining must not prevent a consistent winding. Therefore the step keeps a minimum spanning forest of
       the pairs between parts of the surface. Other pairs are kept if they agree with the winding of this
       forest.
    3. Two pairs of faces may be joined into fans at both ends of an edge. Four faces would then still share
       the edge, so the two pairs are separated. One pass is enough, because separating a pair never joins
       fans.

    The step takes O(F log F) time. A manifold mesh does not change.
    """
    mesh = build_half_edges(faces, len(points))
    first, second = mesh.two_face_halfedges
    if (mesh.multiplicity > 2).any():
        pairs, cost = _choose_pairs(mesh, points, vertex_colors, face_colors, color_weight)
        pairs = pairs[_keep_windable(mesh, pairs, cost)]
        pairs = pairs[_keep_manifold(mesh, pairs)]
        first, second = np.concatenate([first, pairs[:, 0]]), np.concatenate([second, pairs[:, 1]])
    return split_vertices(mesh, first, second)


def _choose_pairs(
    mesh: HalfEdgeMesh,
    points: NDArray[Any],
    vertex_colors: NDArray[Any] | None,
    face_colors: NDArray[Any] | None,
    color_weight: float,
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Return the pairs (n, 2) of half-edges to join at edges with more than two faces, and the cost (n,) of
    each pair."""
    pairs, costs = [], []
    for group in _list_crowded_groups(mesh):
        sides, along = _compute_directions(mesh, points, group)
        if group.shape[1] > MOST_COMPARED:
            chosen = _pair_opposite(sides, along)
            first, second = (np.take_along_axis(sides, chosen[..., end, None], axis=1) for end in (0, 1))
            cost = (1 + np.einsum("npx,npx->np", first, second)) / 2
        else:
            table = (1 + np.einsum("nix,njx->nij", sides, sides)) / 2
            for colors, rows in ((vertex_colors, _find_apexes(mesh, group)), (face_colors, face_of(group))):
                if colors is not None:
                    table += color_weight * _measure_color_distances(colors[rows])
            chosen, cost = _choose_cheapest(table)
        row = np.arange(len(group))[:, None]
        pairs.append(np.stack([group[row, chosen[..., 0]], group[row, chosen[..., 1]]], -1).reshape(-1, 2))
        costs.append(cost.reshape(-1))
    return np.concatenate(pairs), np.concatenate(costs)


def _list_crowded_groups(mesh: HalfEdgeMesh) -> Iterator[NDArray[Any]]:
    """Yield the half-edges (n, k) of edges with k > 2 faces, in batches."""
    for size in np.unique(mesh.multiplicity[mesh.multiplicity > 2]):
        edges = np.flatnonzero(mesh.multiplicity == size)
        chunk = max(_CHUNK // min(int(size), MOST_COMPARED), 1)
        for start in range(0, len(edges), chunk):
            place = mesh.edge_offsets[edges[start : start + chunk], None] + np.arange(size)
            yield mesh.edge_halfedges[place]


def _find_apexes(mesh: HalfEdgeMesh, group: NDArray[Any]) -> NDArray[Any]:
    """Return the vertex opposite to each half-edge."""
    return np.asarray(mesh.origin[next_in_face(next_in_face(group))])


def _compute_directions(
    mesh: HalfEdgeMesh, points: NDArray[Any], group: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two arrays of unit vectors.

    The vectors (n, k, 3) lie in the faces, at a right angle to the edge. The vectors (n, 3) lie along the
    edge. The vectors are zero for a face without height or an edge without length.
    """
    ends = np.sort(np.stack([mesh.origin[group[:, 0]], mesh.origin[next_in_face(group[:, 0])]]), axis=0)
    low, high = points[ends].astype(np.float64)
    along = _normalize(high - low)
    out = points[_find_apexes(mesh, group)].astype(np.float64) - low[:, None]
    size = np.linalg.norm(out, axis=-1, keepdims=True)
    out -= np.einsum("nkx,nx->nk", out, along)[..., None] * along[:, None]
    out[np.linalg.norm(out, axis=-1) <= 1e-12 * size[..., 0]] = 0  # rounding error of a zero height
    return _normalize(out), along


def _normalize(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    largest = np.abs(vectors).max(axis=-1, keepdims=True)
    vectors = np.divide(vectors, largest, out=np.zeros_like(vectors), where=largest > 0)
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, norm, out=np.zeros_like(vectors), where=norm > 0))


def _measure_color_distances(colors: NDArray[Any]) -> NDArray[np.float64]:
    """Return the pairwise distances (n, k, k) of colours (n, k, c), relative to the distance of black and
    white."""
    difference = colors[:, :, None].astype(np.float64) - colors[:, None]
    return np.asarray(np.linalg.norm(difference, axis=-1) / np.sqrt(colors.shape[-1]))


def _choose_cheapest(table: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Choose pairs greedily. Return the pairs (n, k // 2, 2) and their costs.

    If costs are equal, the first pair wins. The argument `table` (n, k, k) holds the costs of all pairs of
    faces. There are k faces at each of n edges.
    """
    count, size, _ = table.shape
    first, second = np.triu_indices(size, 1)
    left = table[:, first, second]
    row = np.arange(count)
    chosen = np.zeros((count, size // 2, 2), np.intp)
    cost = np.zeros((count, size // 2))
    for rank in range(size // 2):
        best = np.argmin(left, axis=1)
        cost[:, rank] = left[row, best]
        chosen[:, rank, 0], chosen[:, rank, 1] = first[best], second[best]
        for end in (first[best], second[best]):
            left[(first == end[:, None]) | (second == end[:, None])] = np.inf
    return chosen, cost


def _pair_opposite(sides: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[Any]:
    """Sort the faces around each edge, and pair the faces on opposite sides of the edge.

    Return the pairs (n, k // 2, 2).
    """
    count, size, _ = sides.shape
    axis = np.zeros_like(along)
    axis[np.arange(count), np.abs(along).argmin(axis=1)] = 1
    right = np.cross(along, axis)
    up = np.cross(along, right)
    angle = np.arctan2(np.einsum("nkx,nx->nk", sides, up), np.einsum("nkx,nx->nk", sides, right))
    order = np.argsort(angle, axis=1, kind="stable")
    half = size // 2
    return np.stack([order[:, :half], order[:, half : 2 * half]], axis=-1)


def _keep_windable(mesh: HalfEdgeMesh, joined: NDArray[Any], cost: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the half-edge pairs that can be joined. After joining, a consistent winding must
    be possible.

    Cheap pairs are considered first.
    """
    # Parts are components across two-face edges. A pair joins two parts of the surface. Keep the pair only if
    # it agrees with the winding of both parts.
    sides = find_sides_of_faces(mesh)
    _, part = np.unique(sides.label, return_inverse=True)
    count = int(part.max(initial=-1)) + 1
    first, second = face_of(joined).T
    clash = mesh.origin[joined[:, 0]] == mesh.origin[joined[:, 1]]
    differ = clash ^ sides.other[first] ^ sides.other[second]
    first, second = part[first], part[second]
    between = np.flatnonzero(first != second)
    # Costs must be positive for the spanning tree.
    tree = between[find_spanning_tree(count, first[between], second[between], 1.0 + cost[between])]
    turned = find_sides(count, first[tree], second[tree], differ[tree]).other
    return np.asarray((turned[first] ^ turned[second]) == differ)


def _keep_manifold(mesh: HalfEdgeMesh, joined: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the half-edge pairs that can be joined. After joining, the mesh must become
    manifold.

    After the vertices are split, each edge then has at most two faces.
    """
    first, second = mesh.two_face_halfedges
    first, second = np.concatenate([first, joined[:, 0]]), np.concatenate([second, joined[:, 1]])
    _, group = group_corners(mesh, first, second)
    # Sort the half-edges of crowded edges by edge and by the groups at both ends. More than two equal entries
    # mean that one edge would keep more than two faces.
    crowded = mesh.edge_halfedges[np.repeat(mesh.multiplicity > 2, mesh.multiplicity)]
    ends = np.stack([mesh.edge[crowded], *(group[corner] for corner in find_end_corners(mesh, crowded))])
    order = np.lexsort(ends)
    differs = np.ones(len(order) + 1, bool)
    differs[1:-1] = (ends[:, order[1:]] != ends[:, order[:-1]]).any(axis=0)
    sizes = np.diff(np.flatnonzero(differs))
    separate = np.ones(mesh.faces.size, bool)
    separate[crowded[order]] = np.repeat(sizes <= 2, sizes)
    return np.asarray(separate[joined[:, 0]])
