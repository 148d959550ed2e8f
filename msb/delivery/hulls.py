"""Convex shapes around points, in units of the diagonal: hulls of patches of a surface, and boxes."""

import numpy as np

from msb.delivery.surface_distance import Floats, Ints, sample_surface
from msb.topology.faces import face_areas
from msb.topology.hulls import hull_directions

# A hull: points (V, 3) and the faces (F, 3) on these points.
PointsAndFaces = tuple[Floats, Ints]

# Largest number of corners of the hull of a patch. Physics engines accept hulls of some dozens of corners.
PATCH_CORNERS = 32
# Thickness of a box or of the hull of a flat patch, relative to the diagonal. With this thickness, the thin
# shape is still a solid.
_MIN_THICKNESS = 1e-3
# A hull counts as flat if its volume, divided by the cube of the diagonal, is below this limit. Flat hulls
# are thickened.
_FLAT_VOLUME = 1e-6
# Two neighbouring patches overlap by this distance at their cut, relative to the diagonal, so that no gap
# remains.
_OVERLAP = 4e-3
# A cut is a plane across a principal axis of a patch. Cuts are tried at these quantiles of the points along
# the axis.
_CUT_QUANTILES = (0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85)
# Number of sample points on the faces. Sample points are used in addition to the vertices, because large
# faces have few vertices.
_SAMPLE_POINTS = 5000
# Only this number of the largest hull faces is tried in the search for the smallest box. The smallest box
# usually has a side on a large hull face.
_MAX_BASES = 500
_TINY = np.finfo(np.float64).tiny
# The corners (8, 3) of a unit box, and its faces (12, 3).
_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
_BOX_FACES = np.array(
    [
        [[0, 1, 3], [0, 3, 2]],
        [[4, 6, 7], [4, 7, 5]],
        [[0, 4, 5], [0, 5, 1]],
        [[2, 3, 7], [2, 7, 6]],
        [[0, 2, 6], [0, 6, 4]],
        [[1, 5, 7], [1, 7, 3]],
    ]
).reshape(-1, 3)


def split_into_patches(points: Floats, faces: Ints, count: int) -> list[Floats]:
    """Divide the points of a surface into up to `count` sets (n, 3).

    The hulls of the sets have a small total volume. The patch with the largest hull is cut repeatedly, at the
    place that saves the most volume.
    """
    points = np.concatenate([points, sample_surface(points, faces, _SAMPLE_POINTS)[0]])
    patches = [(_measure_volume(points), points)]
    while len(patches) < count:
        largest = max(range(len(patches)), key=lambda number: patches[number][0])
        halves = _cut_patch(patches[largest][1])
        if not halves:
            break
        patches[largest : largest + 1] = halves
    return [patch for _, patch in patches]


def _cut_patch(points: Floats) -> list[tuple[float, Floats]]:
    """Cut a patch into the two parts with the smallest total volume.

    Return no parts if the patch cannot be cut.
    """
    best: list[tuple[float, Floats]] = []
    if len(points) < 2:
        return best
    # Try cuts across each principal axis, at the widest gap and at some quantiles.
    for axis in _find_principal_axes(points):
        along = points @ axis
        for place in (_find_widest_gap(along), *np.quantile(along, _CUT_QUANTILES)):
            halves = points[along <= place + _OVERLAP], points[along >= place - _OVERLAP]
            if max(map(len, halves)) < len(points):
                volumes = [_measure_volume(half) for half in halves]
                if not best or sum(volumes) < sum(volume for volume, _ in best):
                    best = list(zip(volumes, halves, strict=True))
    return best


def _find_widest_gap(values: Floats) -> float:
    """Return the middle of the widest gap between consecutive values."""
    ordered = np.sort(values)
    at = int(np.diff(ordered).argmax())
    return float(ordered[at] + ordered[at + 1]) / 2


def _find_principal_axes(points: Floats) -> Floats:
    """Return the principal axes (3, 3) as rows, from the smallest to the largest variance."""
    offset = points - points.mean(axis=0)
    axes: Floats = np.linalg.eigh(offset.T @ offset)[1].T
    return axes


def _measure_volume(points: Floats) -> float:
    """Return the volume of the convex hull. A flat hull is thickened first."""
    exact = _measure_exact_volume(points)
    return exact if exact >= _FLAT_VOLUME else _measure_exact_volume(_thicken(points))


def _measure_exact_volume(points: Floats) -> float:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(points).volume)
    except QhullError:  # The points lie in a plane.
        return 0.0


def _thicken(points: Floats) -> Floats:
    """Return the corners (8n, 3) of a small box around each point (n, 3)."""
    return (points[:, None] + _MIN_THICKNESS / 2 * _BOX_CORNERS).reshape(-1, 3)


def make_hull(points: Floats) -> PointsAndFaces:
    """Return a convex hull of at most `PATCH_CORNERS` of the points. A flat hull is thickened."""
    from scipy.spatial import ConvexHull

    # Select extreme points in evenly spread directions. The coordinates are scaled by the principal axes.
    axes = _find_principal_axes(points)
    along = (points - points.mean(axis=0)) @ axes.T
    along /= np.maximum(np.abs(along).max(axis=0), _TINY)
    corners = points[np.unique((along @ hull_directions(PATCH_CORNERS).T).argmax(axis=0))]
    if _measure_exact_volume(corners) < _FLAT_VOLUME:
        corners = _thicken(corners)
    # Renumber the corners and turn all faces outwards.
    hull = ConvexHull(corners)
    used, number = np.unique(hull.simplices, return_inverse=True)
    faces = number.reshape(-1, 3)
    corners = hull.points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    return hull.points[used], np.where(is_inward[:, None], faces[:, ::-1], faces).astype(np.int64)


def fit_box(points: Floats) -> PointsAndFaces:
    """Return a small box around the points: the smallest box among several orientations.

    The orientations are the coordinate axes, the principal axes, and frames of large faces of the convex
    hull. The frame of a face consists of its normal, an edge, and the direction perpendicular to both.
    """
    bases, corners = _make_hull_frames(points)
    axes = _find_principal_axes(points)
    axes[2] *= np.sign(np.linalg.det(axes))  # A mirrored frame would turn the faces inwards.
    # Measure the extents (n, 3) of the corners along each frame (n, 3, 3). Choose the frame with the smallest
    # volume.
    frames = np.concatenate([[np.eye(3), axes], bases])
    along = np.einsum("nij,pj->npi", frames, corners)
    low, high = along.min(axis=1), along.max(axis=1)
    half = np.maximum(high - low, _MIN_THICKNESS) / 2
    best = int(half.prod(axis=1).argmin())
    placed = ((low[best] + high[best]) / 2 + _BOX_CORNERS * half[best]) @ frames[best]
    return placed, _BOX_FACES


def _make_hull_frames(points: Floats) -> tuple[Floats, Floats]:
    """Return frames (n, 3, 3) for the largest faces of the convex hull, and the corners of the hull."""
    from scipy.spatial import ConvexHull, QhullError

    for options in (
        "Qt",
        "QJ",
    ):  # Qhull's option QJ moves points at random, so that points in a plane have a hull.
        try:
            hull = ConvexHull(points, qhull_options=options)
        except QhullError:
            continue
        corners = hull.points[hull.simplices]
        largest = np.argsort(-face_areas(hull.points, hull.simplices)[0], kind="stable")[:_MAX_BASES]
        # Each side of a face gives a frame. The axes are the side, the direction across the side within the
        # face, and the face normal.
        side = np.roll(corners[largest], -1, axis=1) - corners[largest]
        along = (side / np.maximum(np.linalg.norm(side, axis=2, keepdims=True), _TINY)).reshape(-1, 3)
        up = np.repeat(hull.equations[largest, :3], 3, axis=0)
        return np.stack([along, np.cross(up, along), up], axis=1), hull.points[hull.vertices]
    return np.zeros((0, 3, 3)), points
