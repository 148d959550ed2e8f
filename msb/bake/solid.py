"""From what is solid to a closed surface of few faces: parts that matter, fewer faces, none that cross."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints, Mask, Singles
from msb.bake.colors import laplacian
from msb.bake.options import FEWEST_FACES
from msb.meshes.mesh import Mesh
from msb.topology.components import label_components
from msb.topology.crossings import crossing_pairs
from msb.topology.steps import close, pair, turn_faces

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from msb.bake.fusion import Grid
    from msb.bake.space import Space


_APART = 0.002  # least distance of a cell from the surface, in reaches of a view
# Aggressiveness of the edge collapse; the first gives better meshes, but may end above the face budget.
_HASTE, _MORE_HASTE = 5, 7
# Merged vertices together cover at most this many pixels of an average view, and at most this share of
# what an average vertex covers.
_HARDLY, _LESS = 2.0, 0.1
_COARSEST = 1 / 8  # share of the face budget that a mesh has if all of it is as coarse as unseen parts may be
_DETAIL = 32  # a surface has this multiple of the face budget before faces are weighted by their pixels
_MIDDLE = 0.3  # radius inside a scene's space within which errors count about alike
_FLAT = 1e-3  # area relative to the median below which a face is a sliver, which other libraries drop
_MENDINGS = 5
_TURNS = 32  # times that corners of crossing faces are smoothed
_BACK = 60  # times that corners of crossing faces are put back before all are
_CUTS = 6  # times that faces which still cross are cut out
_WIDER = 8  # smoothing turns after which the neighbours are included, and again after as many


def boundary(values: Singles, grid: Grid, outside: float) -> tuple[Floats, Ints]:
    """Return the surface (V, 3), (F, 3) of what is negative, closed: outside the grid it is `outside`."""
    from skimage.measure import marching_cubes

    # A value of 0 would put all points of a cell's corner at one place, and make faces without area.
    padded = np.pad(values, 1, constant_values=outside)
    np.copyto(padded, np.copysign(np.float32(_APART), padded), where=np.abs(padded) < _APART)
    points, faces, _, _ = marching_cubes(padded, 0.0)  # type: ignore[no-untyped-call]
    return grid.low + (points.astype(np.float64) - 1) * grid.cell, faces.astype(np.int64)


def parts(points: Floats, faces: Ints) -> NDArray[np.int32]:
    """Return the number of the part (F,) that each face belongs to, joined by vertices."""
    one, two = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    _, label = label_components(len(points), one, two)
    return label[faces[:, 0]]


def that_matter(points: Floats, faces: Ints, pixels: Ints, least: float) -> Mask:
    """Return which faces (F,) are of parts that so many pixels show at `least`; those of the largest are."""
    label = parts(points, faces)
    shown = np.bincount(label, weights=pixels)
    keep: Mask = (shown >= least)[label] | (label == int(np.argmax(shown)))
    return keep


def compacted(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the points that faces use, in their order, and the faces that name them."""
    used = np.zeros(len(points), bool)
    used[faces] = True
    return points[used], (np.cumsum(used) - 1)[faces]


def with_fewer_faces(points: Floats, faces: Ints, count: int, space: Space) -> tuple[Floats, Ints]:
    """Return the surface with about `count` faces, by quadric error, and mended to a closed manifold.

    The middle of a scene, which its cameras look at, is given more faces: there errors count as in a space
    where lengths grow as the logarithm of the distance to it."""
    for haste in (_HASTE, _MORE_HASTE):
        points, faces = _coarser(points, faces, count, space, haste)
    return mended(points, faces)


def without_detail(points: Floats, faces: Ints, count: int, space: Space) -> tuple[Floats, Ints]:
    """Return the surface with so many faces that nothing is lost of it for `count` that are asked for in the
    end: what follows takes less time then."""
    return _coarser(points, faces, _DETAIL * count, space, _HASTE)


def _coarser(points: Floats, faces: Ints, count: int, space: Space, haste: int) -> tuple[Floats, Ints]:
    if len(faces) <= count:
        return points, faces
    placed = _to_logarithm(points) if space.contracted else points
    placed, faces, _ = _collapsed(placed, faces, count, haste)
    return _from_logarithm(placed) if space.contracted else placed, faces


def coarser_unseen(
    points: Floats, faces: Ints, pixels: Floats, count: int, space: Space
) -> tuple[Floats, Ints]:
    """Return the surface with one vertex in place of those that hardly any of the `pixels` (F,) of the mean
    view show together, so that of `count` faces that are to stay hardly any go there.

    They are merged along edges that quadric error would collapse, so that it stays the surface it was, until
    all is as coarse as it may be. Ints may touch at an edge then."""
    if len(faces) <= count:
        return points, faces
    # The order in which quadric error collapses edges (n, 2): the vertex that stays, the one that goes.
    placed = _to_logarithm(points) if space.contracted else points
    *_, collapses = _collapsed(placed, faces, max(int(count * _COARSEST), FEWEST_FACES), _HASTE)
    # Pixels of each vertex (V,): a third of those of its faces.
    shown = np.bincount(faces.reshape(-1), np.repeat(pixels / 3, 3), len(points))
    most = min(_HARDLY, _LESS * shown.sum() / (count / 2))
    # Follow the collapses while the merged vertices cover few pixels together.
    held, into = shown.tolist(), list(range(len(points)))
    for stays, goes in collapses.tolist():
        together = held[stays] + held[goes]
        if together < most:
            held[stays], into[goes] = together, stays
        else:  # what is collapsed later counts on this, and stays, too
            held[stays] = held[goes] = math.inf
    # Each vertex becomes the last one of its chain of merges.
    merged = np.array(into)
    while (merged != merged[merged]).any():
        merged = merged[merged]
    return compacted(points, _without_flaps(merged[faces]))


def _collapsed(points: Floats, faces: Ints, count: int, haste: int) -> tuple[Floats, Ints, NDArray[np.int32]]:
    """Return the surface with about `count` faces, and which vertices (n, 2) the edges had that were
    collapsed, in their order: the one that stayed, and the one that went."""
    import fast_simplification

    fewer, kept, collapses = fast_simplification.simplify(
        points.astype(np.float32),
        faces.astype(np.int32),
        target_count=count,
        agg=haste,
        return_collapses=True,
    )
    return fewer.astype(np.float64), kept.astype(np.int64), collapses


def _to_logarithm(points: Floats) -> Floats:
    size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
    return np.asarray(points * (np.log1p(size / _MIDDLE) / size))


def _from_logarithm(points: Floats) -> Floats:
    size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
    return np.asarray(points * (_MIDDLE * np.expm1(size) / size))


def mended(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return a closed, consistently wound manifold: faces that touch at an edge come apart, holes are closed.

    Where that fails faces there are left out, and a part that still stays open.
    """
    for _ in range(_MENDINGS):
        points, faces = compacted(points, _without_flaps(faces))
        change = pair(points, faces)
        points, faces = points[change.vertex_map], change.faces.astype(np.int64)
        faces = turn_faces(faces, len(points)).faces.astype(np.int64)
        points, faces = _capped(points, faces)
        faces = _without_flaps(faces)  # the cap of a lone face lies on it
        torn = _open(faces)
        if not torn.any():
            points, faces = compacted(points, faces)
            # Copies of a vertex part here, so that what is done about crossings knows of it.
            return parted(Mesh(points, faces)).vertices, faces
        faces = faces[~torn]
    label = parts(points, faces)
    closed = np.ones(label.max(initial=-1) + 1, bool)
    closed[label[_open(faces)]] = False
    return compacted(points, faces[closed[label]])


def _without_flaps(faces: Ints) -> Ints:
    """Return the faces without those that name a vertex twice, and without two that lie on each other."""
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    kept: Ints = faces[np.sort(first[count % 2 == 1])]
    return kept


def _capped(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface with its holes closed."""
    change = close(points, faces, most_edges=1 << 30, most_share=1.0)
    added = change.vertex_map < 0
    placed = points[change.vertex_map]
    if added.any():
        rims = change.rims
        sums = np.add.reduceat(points[rims.vertices], rims.offsets[:-1])
        placed[added] = sums / np.diff(rims.offsets)[:, None]
    return placed, change.faces.astype(np.int64)


def _open(faces: Ints) -> Mask:
    """Return which faces (F,) have an edge that no other runs along the other way."""
    count = int(faces.max(initial=0)) + 1
    start, stop = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    lone = np.isin(start * count + stop, stop * count + start, invert=True)
    return np.asarray(lone.reshape(-1, 3).any(axis=1))


def uncrossed(points: Floats, faces: Ints, space: Space) -> tuple[Floats, Ints]:
    """Return a closed surface at points (V, 3) inside `space` of which no faces cross in the world.

    Corners of faces that cross are moved to the middle of their neighbours. Where that does not help, the
    faces around are cut out and the hole is closed; what still crosses then stays.
    """
    best, fewest = (points, faces), np.inf
    for _ in range(_CUTS):
        points, crossing = _smoothed(points, faces, space)
        if len(crossing) < fewest:
            best, fewest = (points, faces), len(crossing)
        if not len(crossing):
            break
        around = np.zeros(len(points), bool)
        around[faces[crossing]] = True
        points, faces = mended(points, faces[~around[faces].any(axis=1)])
    return best


def _smoothed(points: Floats, faces: Ints, space: Space) -> tuple[Floats, Ints]:
    """Return points of which fewer faces cross, and those that still do.

    Those of faces that resist are moved together with their neighbours. So are corners of faces that have
    hardly any area, as long as that helps.
    """
    points = points.copy()
    neighbours = average(faces, len(points))
    moved = np.ones(len(points), bool)
    for turn in range(_TURNS):
        crossing = crossing_faces(points, faces, space, moved)
        flat = _slivers(points, faces) if turn < _WIDER else crossing[:0]
        if not len(crossing) and not len(flat):
            return points, crossing
        moved = np.zeros(len(points), bool)
        moved[faces[crossing]] = moved[faces[flat]] = True
        for _ in range(turn // _WIDER):
            moved[faces[moved[faces].any(axis=1)]] = True
        points[moved] = ((points + neighbours @ points) / 2)[moved]
    return points, crossing_faces(points, faces, space, moved)


def _slivers(points: Floats, faces: Ints) -> Ints:
    """Return the numbers of faces that have hardly any area beside the usual face."""
    sides = points[faces[:, 1:]] - points[faces[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.flatnonzero(area < _FLAT * np.median(area))


def put_back(points: Floats, good: Floats, faces: Ints, space: Space) -> Floats:
    """Return points of which no faces cross but those that do in `good`, too: others go back to where they
    were there."""
    points = points.copy()
    moved = np.ones(len(points), bool)
    for _ in range(_BACK):
        crossing = np.zeros(len(points), bool)
        crossing[faces[crossing_faces(points, faces, space, moved)]] = True
        moved = crossing & (points != good).any(axis=1)
        if not moved.any():
            return points
        points[moved] = good[moved]
    return good.copy()


def crossing_faces(points: Floats, faces: Ints, space: Space, moved: Mask | None = None) -> Ints:
    """Return the numbers of faces that cross others in the world, as float32 has it: of those pairs, one of
    whose faces has a corner (V,) that was `moved`."""
    of = None if moved is None or moved.all() else np.asarray(moved[faces].any(axis=1))
    corners = space.outward(points).astype(np.float32).astype(np.float64)[faces]
    if not space.contracted:
        return np.unique(crossing_pairs(corners, of=of))
    # A face of the world is bent inside: so are its box's corners, the middles of its sides, and its own.
    more = [(corners + np.roll(corners, 1, axis=1)) / 2, corners.mean(axis=1, keepdims=True)]
    bent = np.concatenate([corners, *more], axis=1)
    places = space.inward(bent.reshape(-1, 3)).reshape(bent.shape)
    return np.unique(crossing_pairs(corners, places, of))


def average(faces: Ints, count: int) -> csr_matrix:
    """Return the matrix (V, V) that takes values of vertices to the means of their neighbours."""
    import scipy.sparse as sparse

    tied = laplacian(faces, count)
    degree = tied.diagonal()
    return (sparse.diags(1 / np.maximum(degree, 1)) @ (sparse.diags(degree) - tied)).tocsr()


def parted(mesh: Mesh) -> Mesh:
    """Return `mesh` with no two vertices in one place, since files that double vertices at seams tell them
    by place.

    All but the first of those in a place go a thousandth of the way to the mean of their faces' corners.
    """
    vertices, corners = mesh.vertices.copy(), mesh.faces.reshape(-1)
    count = np.bincount(corners, minlength=len(vertices))
    for _ in range(_MENDINGS):
        # The vertices that repeat the place of an earlier one, and are used by a face.
        _, place = np.unique(vertices, axis=0, return_inverse=True)
        order = np.argsort(place, kind="stable")
        again = order[1:][np.diff(place[order]) == 0]
        again = again[count[again] > 0]
        if not len(again):
            break
        # Move each a thousandth of the way to the mean centre of its faces.
        middles = np.repeat(vertices[mesh.faces].mean(axis=1), 3, axis=0)
        sums = [np.bincount(corners, axis, len(vertices))[again] for axis in middles.T]
        means = np.stack(sums, axis=1) / count[again, None]
        vertices[again] += np.float32(1e-3) * (means.astype(np.float32) - vertices[again])
    return replace(mesh, vertices=vertices)
