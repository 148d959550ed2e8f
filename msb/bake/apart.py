"""How far one surface is from another: points all over the one, and the faces of the other next to them."""

import numpy as np

from msb.bake.arrays import Floats, Ints
from msb.topology.faces import face_areas

POINTS = 20_000  # sample points on a surface that is compared
_MARKS = 40_000  # marks on the other surface that find the nearest faces, besides each face's centre
_CANDIDATES = 12  # nearest marks of a point; the exact distance is taken to the faces of these


def spread(points: Floats, faces: Ints, count: int = POINTS) -> tuple[Floats, Ints]:
    """Return points (count, 3) evenly over the faces, and the face (count,) of each; the same every time.

    Of faces that have no area it is a corner of each.
    """
    area = face_areas(points, faces)[0]
    if not area.sum() > 0:
        return points[faces[:, 0]], np.arange(len(faces))
    random = np.random.default_rng(0)
    chosen = random.choice(len(faces), count, p=area / area.sum())
    weights = random.exponential(size=(count, 3, 1))
    weights /= weights.sum(axis=1, keepdims=True)
    return (weights * points[faces[chosen]]).sum(axis=1), chosen


def distances(places: Floats, points: Floats, faces: Ints) -> Floats:
    """Return how far places (n, 3) are from a surface.

    Ints are found by the marks on them that are nearest, and the distance to these is exact: what it is too
    large by where none of them is the nearest face is far below the distance between marks.
    """
    from scipy.spatial import cKDTree

    if not len(places):
        return np.zeros(0)
    marks, owner = spread(points, faces, _MARKS)
    marks = np.concatenate([marks, points[faces].mean(axis=1)])
    owner = np.concatenate([owner, np.arange(len(faces))])
    marks, first = np.unique(marks, axis=0, return_index=True)  # a tree of one place again and again is slow
    owner = owner[first]
    _, near = cKDTree(marks).query(places, min(_CANDIDATES, len(marks)), workers=-1)
    found = np.full(len(places), np.inf)
    for rank in near.reshape(len(places), -1).T:
        found = np.minimum(found, _to_faces(places, points[faces[owner[rank]]]))
    return found


def _to_faces(places: Floats, corners: Floats) -> Floats:
    """Return the distance of each place (n, 3) to the triangle (n, 3, 3) beside it."""
    sides = np.roll(corners, -1, axis=1) - corners
    away = places[:, None] - corners
    length = np.maximum((sides * sides).sum(axis=2), np.finfo(np.float64).tiny)
    along = np.clip((away * sides).sum(axis=2) / length, 0, 1)
    rim = np.linalg.norm(away - along[..., None] * sides, axis=2).min(axis=1)
    normal = np.cross(sides[:, 0], sides[:, 1])
    size = np.linalg.norm(normal, axis=1)
    above = (np.cross(normal[:, None], sides) * away).sum(axis=2).min(axis=1) >= 0
    height = np.abs((away[:, 0] * normal).sum(axis=1)) / np.where(size > 0, size, 1)
    found: Floats = np.where(above & (size > 0), height, rim)
    return found
