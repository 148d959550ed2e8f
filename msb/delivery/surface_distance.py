"""The distance from one surface to another surface, measured at sample points of the first surface."""

import numpy as np
from numpy.typing import NDArray

from msb.topology.faces import face_areas

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Number of sample points on a surface. With 20,000 points the standard error of an average distance is below
# 1 % of its spread.
POINTS = 20_000
# Number of random search points on the other surface. Each face also has a search point at its centre. Search
# points help to find the nearest faces. With more search points, the nearest face is found more reliably, but
# the search tree is larger.
_SEARCH_POINTS = 40_000
# Number of nearest search points per sample point. Compute the exact distance to the face of each of these
# search points, because the nearest point may not belong to the nearest face.
_NEIGHBOURS = 12


def sample_surface(points: Floats, faces: Ints, count: int = POINTS) -> tuple[Floats, Ints]:
    """Return `count` points (count, 3), distributed uniformly over the area. Also return the face (count,) of
    each point.

    Every call returns the same points. If no face has an area, the points are the first corners of the faces.
    """
    area = face_areas(points, faces)[0]
    if not area.sum() > 0:
        return points[faces[:, 0]], np.arange(len(faces))
    # Choose faces by area. Then choose uniform barycentric weights (count, 3, 1) from normalised exponential
    # variables.
    random = np.random.default_rng(0)
    chosen = random.choice(len(faces), count, p=area / area.sum())
    weights = random.exponential(size=(count, 3, 1))
    weights /= weights.sum(axis=1, keepdims=True)
    return (weights * points[faces[chosen]]).sum(axis=1), chosen


def measure_distances(places: Floats, points: Floats, faces: Ints) -> Floats:
    """Return the distance (n,) from each place (n, 3) to a surface of points (V, 3) and faces (F, 3).

    The distance to each candidate face is exact. The function compares candidate faces only, and the
    nearest face may be missing. The result is then slightly too large. The error is far below the spacing of
    the search points.
    """
    from scipy.spatial import cKDTree

    if not len(places):
        return np.zeros(0)
    # Search points are random points and the centre of each face. Drop equal points, because a search tree of
    # many equal points is slow.
    marks, owner = sample_surface(points, faces, _SEARCH_POINTS)
    marks = np.concatenate([marks, points[faces].mean(axis=1)])
    owner = np.concatenate([owner, np.arange(len(faces))])
    marks, first = np.unique(marks, axis=0, return_index=True)
    owner = owner[first]
    # Compute the exact distances to the faces of the nearest search points (n, _NEIGHBOURS), and take the
    # minimum.
    _, near = cKDTree(marks).query(places, min(_NEIGHBOURS, len(marks)), workers=-1)
    distance = np.full(len(places), np.inf)
    for rank in near.reshape(len(places), -1).T:
        distance = np.minimum(distance, _distance_to_triangles(places, points[faces[owner[rank]]]))
    return distance


def _distance_to_triangles(places: Floats, corners: Floats) -> Floats:
    """Return the distance (n,) from each place (n, 3) to its triangle (n, 3, 3)."""
    # Compute the distance to the three edges (n, 3). Project the place onto each edge, and clamp the result
    # to the ends of the edge.
    sides = np.roll(corners, -1, axis=1) - corners
    away = places[:, None] - corners
    length = np.maximum((sides * sides).sum(axis=2), np.finfo(np.float64).tiny)
    along = np.clip((away * sides).sum(axis=2) / length, 0, 1)
    edge_distance = np.linalg.norm(away - along[..., None] * sides, axis=2).min(axis=1)
    # Compute the distance to the plane for places above the interior of a triangle. Exclude triangles without
    # an area.
    normal = np.cross(sides[:, 0], sides[:, 1])
    size = np.linalg.norm(normal, axis=1)
    is_above = (np.cross(normal[:, None], sides) * away).sum(axis=2).min(axis=1) >= 0
    height = np.abs((away[:, 0] * normal).sum(axis=1)) / np.where(size > 0, size, 1)
    distance: Floats = np.where(is_above & (size > 0), height, edge_distance)
    return distance
