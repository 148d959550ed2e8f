"""Check whether the bodies of a closed mesh are wound inside out, touch each other, or cross each other."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.crossings import find_crossing_pairs
from msb.topology.weld import find_coincident_vertices

# Larger meshes are checked for crossing faces only on request. The check takes about 8 us per face on one
# core.
MOST_FACES = 200_000
# A body whose volume is below this share of (area)^1.5 is flat. A sphere has the share 0.094.
_FLAT = 1e-9


@dataclass(frozen=True)
class Bodies:
    """Faults of a closed, manifold and consistently wound mesh that its counts do not show.

    Attributes
    ----------
    inside_out : int
        Number of bodies that are wound inside out. A cavity, which lies inside another body, is not.
    touching_vertices : int
        Number of vertices that coincide with a vertex of another body.
    crossing_faces : int or None
        Number of faces that cross another face; None if this was not checked (more than 200,000 faces).
    """

    inside_out: int
    touching_vertices: int
    crossing_faces: int | None


def check_bodies(points: NDArray[Any], faces: NDArray[Any]) -> Bodies:
    """Return the state of the bodies of a closed mesh with finite coordinates."""
    label = label_bodies(faces, len(points))
    # Find coincident vertices that belong to different bodies.
    used = np.unique(faces)
    rows, group = find_coincident_vertices(points[used])
    body = np.full(len(points), -1)
    body[faces.reshape(-1)] = np.repeat(label, 3)
    of_row = body[used[rows]]
    touching = np.zeros(len(rows), bool)
    if len(rows):
        lowest, highest = np.full(len(rows), len(faces)), np.full(len(rows), -1)
        np.minimum.at(lowest, group, of_row)
        np.maximum.at(highest, group, of_row)
        touching = (lowest != highest)[group]
    crossing = None
    if len(faces) <= MOST_FACES:
        crossing = len(np.unique(find_crossing_pairs(points[faces].astype(np.float64))))
    inside_out = int(find_inside_out(points, faces, label).sum())
    return Bodies(inside_out, int(touching.sum()), crossing)


def label_bodies(faces: NDArray[Any], vertex_count: int) -> NDArray[Any]:
    """Return the body (F,) of each face: faces that share a vertex, numbered from 0."""
    first, second = (faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1))
    _, of_vertex = label_components(vertex_count, first, second)
    return np.asarray(np.unique(of_vertex[faces[:, 0]], return_inverse=True)[1].reshape(-1))


def find_inside_out(points: NDArray[Any], faces: NDArray[Any], label: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which closed bodies (n,) are wound inside out; `label` (F,) is the body of each face.

    A body of negative volume inside the bounding box of a larger body of positive volume is a cavity.
    """
    count = int(label.max(initial=-1)) + 1
    corners = points[faces].astype(np.float64)
    corners -= corners.reshape(-1, 3).mean(axis=0)
    a, b, c = corners.transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    volume = np.bincount(label, (a * cross).sum(axis=1) / 6, count)
    area = np.bincount(label, np.linalg.norm(cross, axis=1) / 2, count)
    # low, high (n, 3): bounding boxes.
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    low = np.minimum.reduceat(corners.min(axis=1)[order], starts)
    high = np.maximum.reduceat(corners.max(axis=1)[order], starts)
    negative = volume < -_FLAT * area**1.5
    solid = volume > 0
    for body in np.flatnonzero(negative):
        around = solid & (volume > -volume[body])
        around &= (low <= low[body]).all(axis=1) & (high >= high[body]).all(axis=1)
        negative[body] = not around.any()
    return np.asarray(negative)
