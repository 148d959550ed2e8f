"""Convex shapes about points, in units of their diagonal: hulls of patches of a surface, the smallest box."""

import numpy as np

from msb.bake.apart import spread
from msb.bake.arrays import Floats, Ints
from msb.topology.faces import face_areas
from msb.topology.hulls import hull_directions

# Points (V, 3) and the faces (F, 3) on them.
Part = tuple[Floats, Ints]

PATCH_CORNERS = 32  # most corners of the hull of a patch, and about its number of faces
_THIN = 1e-3  # thickness of a box, or of the hull of a flat patch, relative to the diagonal
_FLAT = 1e-6  # volume below which a hull counts as flat, relative to the diagonal's cube
_OVERLAP = 4e-3  # reach of either patch beyond a cut, relative to the diagonal, so that nothing falls through
# Shares of a patch's points on one side of a tried cut, along each of its axes.
_CUTS = (0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85)
_SPREAD = 5000  # sample points on the faces, besides their corners, that make up patches
_BASES = 500  # the largest faces of a hull on which a box is tried
_LEAST = np.finfo(np.float64).tiny
# The lower and upper ends of three axes.
_ENDS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
# The faces of a box with its corners in the order of `_ENDS`.
_BOX = np.array(
    [
        [[0, 1, 3], [0, 3, 2]],
        [[4, 6, 7], [4, 7, 5]],
        [[0, 4, 5], [0, 5, 1]],
        [[2, 3, 7], [2, 7, 6]],
        [[0, 2, 6], [0, 6, 4]],
        [[1, 5, 7], [1, 7, 3]],
    ]
).reshape(-1, 3)


def patches_of(points: Floats, faces: Ints, count: int) -> list[Floats]:
    """Return up to so many sets of points of a surface, whose hulls have little volume together.

    Again and again the one with the largest hull is cut where that saves most.
    """
    points = np.concatenate([points, spread(points, faces, _SPREAD)[0]])
    patches = [(_volume(points), points)]
    while len(patches) < count:
        largest = max(range(len(patches)), key=lambda number: patches[number][0])
        halves = _cut(patches[largest][1])
        if not halves:
            break
        patches[largest : largest + 1] = halves
    return [patch for _, patch in patches]


def _cut(points: Floats) -> list[tuple[float, Floats]]:
    """Return two parts of a patch, each with its volume, that are least together; none of what is one
    place."""
    found: list[tuple[float, Floats]] = []
    if len(points) < 2:
        return found
    for axis in _principal_axes(points):
        along = points @ axis
        for place in (_widest_gap(along), *np.quantile(along, _CUTS)):
            halves = points[along <= place + _OVERLAP], points[along >= place - _OVERLAP]
            if max(map(len, halves)) < len(points):
                volumes = [_volume(half) for half in halves]
                if not found or sum(volumes) < sum(volume for volume, _ in found):
                    found = list(zip(volumes, halves, strict=True))
    return found


def _widest_gap(values: Floats) -> float:
    """Return the middle between the two of neighbouring values that are farthest from each other."""
    ordered = np.sort(values)
    at = int(np.diff(ordered).argmax())
    return float(ordered[at] + ordered[at + 1]) / 2


def _principal_axes(points: Floats) -> Floats:
    """Return the axes (3, 3), one a row, along which points vary least to most."""
    away = points - points.mean(axis=0)
    axes: Floats = np.linalg.eigh(away.T @ away)[1].T
    return axes


def _volume(points: Floats) -> float:
    """Return the volume of the convex hull, a little thicker where that is flat."""
    exact = _exact_volume(points)
    return exact if exact >= _FLAT else _exact_volume(_thicker(points))


def _exact_volume(points: Floats) -> float:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(points).volume)
    except QhullError:  # they lie in a plane
        return 0.0


def _thicker(points: Floats) -> Floats:
    """Return the corners of small boxes about points."""
    return (points[:, None] + _THIN / 2 * _ENDS).reshape(-1, 3)


def hull_of(points: Floats) -> Part:
    """Return the convex hull of what reaches farthest, a little thicker where that is flat."""
    from scipy.spatial import ConvexHull

    axes = _principal_axes(points)
    along = (points - points.mean(axis=0)) @ axes.T
    along /= np.maximum(np.abs(along).max(axis=0), _LEAST)
    corners = points[np.unique((along @ hull_directions(PATCH_CORNERS).T).argmax(axis=0))]
    if _exact_volume(corners) < _FLAT:
        corners = _thicker(corners)
    hull = ConvexHull(corners)
    used, number = np.unique(hull.simplices, return_inverse=True)
    faces = number.reshape(-1, 3)
    corners = hull.points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    return hull.points[used], np.where(inwards[:, None], faces[:, ::-1], faces).astype(np.int64)


def smallest_box(points: Floats) -> Part:
    """Return the smallest box that holds the points, of those along some axes.

    These are the axes of the space, the principal ones, and the ones by which a box lies on a face of the
    hull with a side along an edge of that.
    """
    bases, corners = _bases(points)
    axes = _principal_axes(points)
    axes[2] *= np.sign(np.linalg.det(axes))  # of a mirrored frame the faces would look inwards
    frames = np.concatenate([[np.eye(3), axes], bases])
    along = np.einsum("nij,pj->npi", frames, corners)
    low, high = along.min(axis=1), along.max(axis=1)
    half = np.maximum(high - low, _THIN) / 2
    best = int(half.prod(axis=1).argmin())
    placed = ((low[best] + high[best]) / 2 + _ENDS * half[best]) @ frames[best]
    return placed, _BOX


def _bases(points: Floats) -> tuple[Floats, Floats]:
    """Return the axes (n, 3, 3) of faces of the hull, from its largest on, and the corners of the hull."""
    from scipy.spatial import ConvexHull, QhullError

    for options in ("Qt", "QJ"):  # joggled, what is flat has a hull, too
        try:
            hull = ConvexHull(points, qhull_options=options)
        except QhullError:
            continue
        corners = hull.points[hull.simplices]
        largest = np.argsort(-face_areas(hull.points, hull.simplices)[0], kind="stable")[:_BASES]
        side = np.roll(corners[largest], -1, axis=1) - corners[largest]
        along = (side / np.maximum(np.linalg.norm(side, axis=2, keepdims=True), _LEAST)).reshape(-1, 3)
        up = np.repeat(hull.equations[largest, :3], 3, axis=0)
        return np.stack([along, np.cross(up, along), up], axis=1), hull.points[hull.vertices]
    return np.zeros((0, 3, 3)), points
