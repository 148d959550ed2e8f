"""Closed meshes: extraction from grid votes, face reduction, repair, and removal of crossing faces."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints, Mask, Singles
from msb.bake.color_fit import make_edge_laplacian
from msb.delivery.collision_kinds import MIN_CLOSED_FACES
from msb.meshes.mesh import Mesh
from msb.topology.components import label_components
from msb.topology.crossings import find_crossing_pairs
from msb.topology.steps import close, pair, turn_faces

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from msb.bake.depth_fusion import Grid
    from msb.bake.space import Space

# Extraction.
#
# Smallest absolute value of a cell's vote. A vote of 1 means a distance of 3 cells. If a cell had the vote 0,
# the surface points on all edges of the cell would coincide, and their faces would have no area.
_MIN_VOTE = 0.002

# Parameters of the face reduction.
#
# Growth of the allowed error per pass of the edge collapse: the parameter `agg` of fast_simplification. The
# value 5 gives better meshes, but may exceed the face budget. The value 7 is the default of
# fast_simplification.
_AGGRESSIVENESS, _HIGH_AGGRESSIVENESS = 5, 7
# Two vertices are merged if the number of pixels that show either vertex is below both limits. The limit
# `_MAX_MERGED_PIXELS` is in pixels of an average view. The limit `_MAX_MERGED_SHARE` is relative to the
# average number of pixels per vertex after the reduction. With these limits, unseen parts of a walled scene
# have 10 % of the faces instead of 43 %. These limits raise the PSNR by 0.3 dB.
_MAX_MERGED_PIXELS, _MAX_MERGED_SHARE = 2.0, 0.1
# Before merging, a trial reduction collapses edges until this share of the face budget remains. Only vertices
# at these edges are merged. This limit prevents unseen parts from becoming too coarse.
_COARSEST_SHARE = 1 / 8
# A surface is first reduced to this multiple of the face budget. All further reductions start from this
# result. This common first step saves a fifth of the time and loses no relevant detail.
_DETAIL_FACTOR = 32
# Radius in the coordinates of a scene. Within the radius, all errors have about the same weight. Outside this
# radius, lengths are measured on a logarithmic scale.
_MIDDLE_RADIUS = 0.3

# Parameters for the repair of slivers and crossing faces.
#
# A face is a sliver if its area, relative to the median area, is below this limit. Other libraries drop such
# slivers.
_SLIVER_AREA = 1e-3
# Largest number of rounds of a surface repair. After each round, the repair removes faces with open edges and
# starts again.
_REPAIR_ROUNDS = 5
# Largest number of rounds of smoothing the corners of crossing faces. After every `_WIDEN_ROUNDS` rounds, one
# more ring of neighbours is smoothed as well.
_SMOOTH_ROUNDS, _WIDEN_ROUNDS = 32, 8
# Largest number of rounds that move the corners of crossing faces back to earlier places. If faces still
# cross after the last round, all corners are moved back. Several rounds are needed, because moving corners
# back can make other faces cross.
_REVERT_ROUNDS = 60
# Largest number of rounds that cut out the remaining crossing faces and close the holes.
_CUT_ROUNDS = 6
# If two vertices coincide, one vertex moves by this share of the way to the average centre of its faces. A
# move of this size is invisible, but larger than the rounding error of float32.
_SEPARATION = 1e-3


def extract_boundary(values: Singles, grid: Grid, outside: float) -> tuple[Floats, Ints]:
    """Return the boundary between negative and positive cells, as points (V, 3) and faces (F, 3).

    Beyond the grid, every cell has the vote `outside`.
    """
    from skimage.measure import marching_cubes

    padded = np.pad(values, 1, constant_values=outside)
    np.copyto(padded, np.copysign(np.float32(_MIN_VOTE), padded), where=np.abs(padded) < _MIN_VOTE)
    points, faces, _, _ = marching_cubes(padded, 0.0)  # type: ignore[no-untyped-call]
    return grid.low + (points.astype(np.float64) - 1) * grid.cell, faces.astype(np.int64)


def label_parts(points: Floats | Singles, faces: Ints) -> NDArray[np.int32]:
    """Return the index (F,) of the connected part that contains each face. Different parts share no
    vertex."""
    _, label = label_components(len(points), faces[:, :2].reshape(-1), faces[:, 1:].reshape(-1))
    return label[faces[:, 0]]


def select_visible_parts(points: Floats, faces: Ints, pixels: Ints, least: float) -> Mask:
    """Return a mask (F,) of the most visible part and of every part that at least `least` pixels show.

    The argument `pixels` (F,) is the number of pixels that show each face.
    """
    label = label_parts(points, faces)
    part_pixels = np.bincount(label, weights=pixels)
    selected: Mask = (part_pixels >= least)[label] | (label == int(np.argmax(part_pixels)))
    return selected


def drop_unused_points(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the points that faces use, in their previous order.

    Also return the faces with the new point indices.
    """
    used = np.zeros(len(points), bool)
    used[faces] = True
    return points[used], (np.cumsum(used) - 1)[faces]


def reduce_faces(points: Floats, faces: Ints, count: int, space: Space) -> tuple[Floats, Ints]:
    """Reduce the surface to about `count` faces by quadric error, and repair it to a closed manifold.

    The cameras look at the middle of a scene, so the middle should get more faces. Errors are measured on a
    logarithmic scale of the distance from the middle.
    """
    for aggressiveness in (_AGGRESSIVENESS, _HIGH_AGGRESSIVENESS):
        points, faces = _reduce(points, faces, count, space, aggressiveness)
    return repair_closed(points, faces)


def remove_detail(points: Floats, faces: Ints, count: int, space: Space) -> tuple[Floats, Ints]:
    """Remove detail that `count` faces cannot show, which saves time in later steps. Return the surface."""
    return _reduce(points, faces, _DETAIL_FACTOR * count, space, _AGGRESSIVENESS)


def _reduce(
    points: Floats, faces: Ints, count: int, space: Space, aggressiveness: int
) -> tuple[Floats, Ints]:
    if len(faces) <= count:
        return points, faces
    placed = _to_logarithm(points) if space.contracted else points
    placed, faces, _ = _collapse_edges(placed, faces, count, aggressiveness)
    return _from_logarithm(placed) if space.contracted else placed, faces


def coarsen_unseen(
    points: Floats, faces: Ints, pixels: Floats, count: int, space: Space
) -> tuple[Floats, Ints]:
    """Merge the vertices of hardly visible parts, so that these parts use few of the `count` faces.

    The argument `pixels` (F,) is the number of pixels of an average view that show each face. Vertices are
    merged along edges that a reduction by quadric error also collapses, so that the surface keeps its shape.
    After merging, more than two faces may meet at an edge.
    """
    if len(faces) <= count:
        return points, faces
    # Collapsed edges (n, 2) in order. Each edge names the vertex that stays and the vertex that is removed.
    placed = _to_logarithm(points) if space.contracted else points
    target = max(int(count * _COARSEST_SHARE), MIN_CLOSED_FACES)
    *_, collapses = _collapse_edges(placed, faces, target, _AGGRESSIVENESS)
    # Pixels of each vertex (V,): a third of the pixels of its adjacent faces. A mesh has about half as many
    # vertices as faces.
    vertex_pixels = np.bincount(faces.reshape(-1), np.repeat(pixels / 3, 3), len(points))
    most = min(_MAX_MERGED_PIXELS, _MAX_MERGED_SHARE * vertex_pixels.sum() / (count / 2))
    # Apply each collapse in which the two vertices together cover few pixels.
    covered, into = vertex_pixels.tolist(), list(range(len(points)))
    for stays, goes in collapses.tolist():
        together = covered[stays] + covered[goes]
        if together < most:
            covered[stays], into[goes] = together, stays
        else:  # After a merge, skip later collapses that need one of its vertices.
            covered[stays] = covered[goes] = math.inf
    # Replace each vertex by the last vertex of its chain of merges.
    merged = np.array(into)
    while (merged != merged[merged]).any():
        merged = merged[merged]
    return drop_unused_points(points, _drop_flaps(merged[faces]))


def _collapse_edges(
    points: Floats, faces: Ints, count: int, aggressiveness: int
) -> tuple[Floats, Ints, NDArray[np.int32]]:
    """Reduce the surface to about `count` faces. Also return the collapsed edges (n, 2) in their order.

    An edge is a pair of vertex indices: the vertex that stays and the vertex that is removed.
    """
    import fast_simplification

    reduced, rest, collapses = fast_simplification.simplify(
        points.astype(np.float32),
        faces.astype(np.int32),
        target_count=count,
        agg=aggressiveness,
        return_collapses=True,
    )
    return reduced.astype(np.float64), rest.astype(np.int64), collapses


def _to_logarithm(points: Floats) -> Floats:
    size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
    return np.asarray(points * (np.log1p(size / _MIDDLE_RADIUS) / size))


def _from_logarithm(points: Floats) -> Floats:
    size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
    return np.asarray(points * (_MIDDLE_RADIUS * np.expm1(size) / size))


def repair_closed(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface, repaired to a closed, consistently wound manifold.

    Surfaces that touch at an edge are separated, and holes are closed. Faces that stay open are removed, and
    the new holes are closed. Parts that are still open after several rounds are removed.
    """
    for _ in range(_REPAIR_ROUNDS):
        # Pair the faces at edges with more than two faces, make the winding consistent, and close the holes.
        points, faces = drop_unused_points(points, _drop_flaps(faces))
        change = pair(points, faces)
        points, faces = points[change.vertex_map], change.faces.astype(np.int64)
        faces = turn_faces(faces, len(points)).faces.astype(np.int64)
        points, faces = _close_holes(points, faces)
        faces = _drop_flaps(faces)  # Closing the hole of a lone face adds a second face at the same place.
        is_open = _find_open_faces(faces)
        if not is_open.any():
            points, faces = drop_unused_points(points, faces)
            # Separate coinciding vertices here, so that the removal of crossings uses their final places.
            return separate_vertices(Mesh(points, faces)).vertices, faces
        faces = faces[~is_open]
    label = label_parts(points, faces)
    is_closed = np.ones(label.max(initial=-1) + 1, bool)
    is_closed[label[_find_open_faces(faces)]] = False
    return drop_unused_points(points, faces[is_closed[label]])


def _drop_flaps(faces: Ints) -> Ints:
    """Drop faces that use a vertex twice, and pairs of coinciding faces."""
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    rest: Ints = faces[np.sort(first[count % 2 == 1])]
    return rest


def _close_holes(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface with its holes closed. Each hole is closed with a fan of faces around the average of
    its rim vertices."""
    change = close(points, faces, most_edges=1 << 30, most_share=1.0)
    is_new = change.vertex_map < 0
    placed = points[change.vertex_map]
    if is_new.any():
        rims = change.rims
        sums = np.add.reduceat(points[rims.vertices], rims.offsets[:-1])
        placed[is_new] = sums / np.diff(rims.offsets)[:, None]
    return placed, change.faces.astype(np.int64)


def _find_open_faces(faces: Ints) -> Mask:
    """Return a mask (F,) of the faces with an open or inconsistently wound edge."""
    count = int(faces.max(initial=0)) + 1
    start, stop = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    is_lone = np.isin(start * count + stop, stop * count + start, invert=True)
    return np.asarray(is_lone.reshape(-1, 3).any(axis=1))


def remove_crossings(points: Floats, faces: Ints, space: Space) -> tuple[Floats, Ints]:
    """Remove crossing faces from a closed surface. The points (V, 3) are in the coordinates of `space`, and
    crossings are tested in world coordinates.

    Corners of crossing faces are smoothed. If smoothing does not help, the crossing faces and their
    neighbours are cut out and the hole is closed. If faces still cross after several rounds, the surface with
    the fewest crossing faces is returned.
    """
    best, fewest = (points, faces), np.inf
    for _ in range(_CUT_ROUNDS):
        points, crossing = _smooth_crossings(points, faces, space)
        if len(crossing) < fewest:
            best, fewest = (points, faces), len(crossing)
        if not len(crossing):
            break
        around = np.zeros(len(points), bool)
        around[faces[crossing]] = True
        points, faces = repair_closed(points, faces[~around[faces].any(axis=1)])
    return best


def _smooth_crossings(points: Floats, faces: Ints, space: Space) -> tuple[Floats, Ints]:
    """Return smoothed points (V, 3) with fewer crossing faces. Also return the remaining crossing faces.

    Corners of crossing faces move half way to the average of their neighbours. In the first rounds, corners
    of sliver faces move as well. If faces still cross after some rounds, the vertices around their corners
    move as well.
    """
    points = points.copy()
    neighbours = make_neighbour_average(faces, len(points))
    moved = np.ones(len(points), bool)
    for turn in range(_SMOOTH_ROUNDS):
        crossing = find_crossing_faces(points, faces, space, moved)
        slivers = _find_slivers(points, faces) if turn < _WIDEN_ROUNDS else crossing[:0]
        if not len(crossing) and not len(slivers):
            return points, crossing
        moved = np.zeros(len(points), bool)
        moved[faces[crossing]] = moved[faces[slivers]] = True
        for _ in range(turn // _WIDEN_ROUNDS):
            moved[faces[moved[faces].any(axis=1)]] = True
        points[moved] = ((points + neighbours @ points) / 2)[moved]
    return points, find_crossing_faces(points, faces, space, moved)


def _find_slivers(points: Floats, faces: Ints) -> Ints:
    """Return the indices of faces whose area is far below the median."""
    sides = points[faces[:, 1:]] - points[faces[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.flatnonzero(area < _SLIVER_AREA * np.median(area))


def revert_crossings(points: Floats, good: Floats, faces: Ints, space: Space) -> Floats:
    """Move the corners of crossing faces back to their places in `good` (V, 3). Return the points (V, 3).

    The result may still contain pairs of faces that cross in `good`, but no other crossing pairs.
    """
    points = points.copy()
    moved = np.ones(len(points), bool)
    for _ in range(_REVERT_ROUNDS):
        crossing = np.zeros(len(points), bool)
        crossing[faces[find_crossing_faces(points, faces, space, moved)]] = True
        moved = crossing & (points != good).any(axis=1)
        if not moved.any():
            return points
        points[moved] = good[moved]
    return good.copy()


def find_crossing_faces(points: Floats, faces: Ints, space: Space, moved: Mask | None = None) -> Ints:
    """Return the indices of the faces that cross other faces in world coordinates, rounded to float32.

    With `moved` (V,), only pairs of faces with a moved corner are tested.
    """
    tested = None if moved is None or moved.all() else np.asarray(moved[faces].any(axis=1))
    corners = space.to_world(points).astype(np.float32).astype(np.float64)[faces]
    if not space.contracted:
        return np.unique(find_crossing_pairs(corners, of=tested))
    # Boxes in the contracted coordinates find candidate pairs of crossing faces. A face that is flat in the
    # world is bent in contracted coordinates. Therefore the box of a face contains the face's corners, edge
    # midpoints and centre (F, 7, 3).
    more = [(corners + np.roll(corners, 1, axis=1)) / 2, corners.mean(axis=1, keepdims=True)]
    bent = np.concatenate([corners, *more], axis=1)
    places = space.from_world(bent.reshape(-1, 3)).reshape(bent.shape)
    return np.unique(find_crossing_pairs(corners, places, tested))


def make_neighbour_average(faces: Ints, count: int) -> csr_matrix:
    """Return the sparse matrix (V, V) that averages values over the neighbours of each vertex."""
    import scipy.sparse as sparse

    laplacian = make_edge_laplacian(faces, count)
    degree = laplacian.diagonal()
    return (sparse.diags(1 / np.maximum(degree, 1)) @ (sparse.diags(degree) - laplacian)).tocsr()


def separate_vertices(mesh: Mesh) -> Mesh:
    """Return `mesh` with no two vertices at one place.

    Files store the vertices of a seam twice, and readers merge all vertices with equal coordinates. The first
    vertex at a place stays. Each other vertex at this place moves slightly towards the average centre of its
    faces.
    """
    vertices, corners = mesh.vertices.copy(), mesh.faces.reshape(-1)
    count = np.bincount(corners, minlength=len(vertices))
    for _ in range(_REPAIR_ROUNDS):
        # Indices (n,) of the used vertices with the coordinates of an earlier vertex.
        _, place = np.unique(vertices, axis=0, return_inverse=True)
        order = np.argsort(place, kind="stable")
        again = order[1:][np.diff(place[order]) == 0]
        again = again[count[again] > 0]
        if not len(again):
            break
        # Move each of the coinciding vertices towards the average centre (n, 3) of its faces.
        centers = np.repeat(vertices[mesh.faces].mean(axis=1), 3, axis=0)
        sums = [np.bincount(corners, axis, len(vertices))[again] for axis in centers.T]
        means = np.stack(sums, axis=1) / count[again, None]
        vertices[again] += np.float32(_SEPARATION) * (means.astype(np.float32) - vertices[again])
    return replace(mesh, vertices=vertices)
