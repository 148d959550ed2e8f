"""Poses of the camera: the first view of a mesh, and views of an element or a component."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers.model import ViewModel

# Vertical field of view in radians.
FOV_Y = math.radians(30)
# Angles of the first view in radians. The first view of an object shows three of its sides at oblique angles.
AZIMUTH, ELEVATION = math.radians(35), math.radians(20)
# Distance of the camera in the first view. At distance 1, the whole mesh just fits into the view.
_MARGIN = 1.04
# Distance between the camera and an element. The unit is the radius of the faces around the element. At this
# distance, the faces around the element fill about half of the window.
_NEIGHBOURHOOD = 4.5


@dataclass(frozen=True, eq=False)
class Pose:
    """The position of a camera, its target point, and its up vector, each (3,) float64 in view units.

    View units are the coordinates of `ViewModel.points`.
    """

    eye: NDArray[np.float64]
    target: NDArray[np.float64]
    up: NDArray[np.float64]

    @property
    def distance(self) -> float:
        """The distance from the eye to the target."""
        return float(np.linalg.norm(self.eye - self.target))


def up_vector(axis: str) -> NDArray[np.float64]:
    """Return an axis such as "+y" as a unit vector.

    >>> up_vector("-z").tolist()
    [0.0, 0.0, -1.0]
    """
    vector = np.zeros(3)
    vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
    return vector


def default_pose(axis: str, aspect: float) -> Pose:
    """Return the first view of a mesh.

    The unit sphere fills an area whose width divided by its height is `aspect`.
    """
    up = up_vector(axis)
    # Compute the two other axes, so that (first, second, up) is a right-handed frame.
    first = np.roll(np.abs(up), 1)
    second = np.cross(up, first)
    level = math.cos(AZIMUTH) * first + math.sin(AZIMUTH) * second
    direction = math.cos(ELEVATION) * level + math.sin(ELEVATION) * up
    return Pose(_fitting_distance(aspect) * direction, np.zeros(3), up)


def element_pose(model: ViewModel, vertices: NDArray[Any], current: Pose) -> Pose | None:
    """Return a view of an element with `vertices` (k,). If possible, no other face hides the element.

    The result is None if the element has no finite position. The direction is chosen among about 100
    candidates. The most important criterion is that no faces are between the element and the camera. If
    several directions have equally few hiding faces, frontal views of the element are preferred. Views close
    to the `current` view are also preferred.
    """
    if not bool(model.finite(vertices[None])[0]):
        return None
    # Find the faces at the element, compute their radius, and compute the camera distance.
    points, faces = model.points, model.faces
    target = points[vertices].astype(np.float64).mean(axis=0)
    touching = np.zeros(len(points), bool)
    touching[vertices] = True
    nearby = np.flatnonzero(touching[faces].any(axis=1) & model.drawn)
    around = points[faces[nearby]].reshape(-1, 3) if len(nearby) else points[vertices]
    radius = float(np.linalg.norm(around - target, axis=1).max(initial=0.0))
    distance = _NEIGHBOURHOOD * (radius if radius > 1e-7 else 0.02)
    # Select the other faces that can be between the element and the camera.
    blockers = np.flatnonzero(_may_reach(points, faces, target, distance) & model.drawn)
    blockers = np.setdiff1d(blockers, nearby, assume_unique=True)
    # Collect candidate directions (m, 3): the current direction, the normals of the faces, and 48 directions
    # on a sphere.
    prefer = _unit(current.eye - current.target)
    normals = _normals(points[faces[nearby]].astype(np.float64))
    directions = np.concatenate([prefer[None], normals, -normals, sphere(48)])[:120]
    facing = np.abs(directions @ normals.T).mean(axis=1) if len(normals) else np.ones(len(directions))
    # Cast rays from the centre and from points near the vertices. Count the hit faces for each of the m
    # directions.
    spots = [target, *(target + 0.7 * (points[vertices].astype(np.float64) - target))]
    triangles = points[faces[blockers]].astype(np.float64)
    hidden = sum(_hits(triangles, spot, directions, distance) for spot in spots)
    if len(vertices) > 1:  # the camera must not look along an edge
        along = _unit(points[vertices[1]].astype(np.float64) - points[vertices[0]])
        facing = facing + 1 - np.abs(directions @ along)
    score = facing + 0.5 * (directions @ prefer) - 10.0 * np.minimum(hidden, 9)
    best = directions[int(np.argmax(score))]
    up = current.up if abs(float(best @ current.up)) < 0.97 else _unit(np.roll(current.up, 1))
    return Pose(target + distance * best, target, up)


def component_pose(model: ViewModel, component: int, current: Pose, aspect: float) -> Pose | None:
    """Return a view in the current direction, in which the component fills the image.

    The result is None if the component has no drawn face.
    """
    faces = model.faces[model.faces_of(component)]
    if len(faces) == 0:
        return None
    corners = model.points[faces.reshape(-1)].astype(np.float64)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = float(np.linalg.norm(corners - middle, axis=1).max()) or 0.02
    return Pose(
        middle + _fitting_distance(aspect) * radius * _unit(current.eye - current.target), middle, current.up
    )


def _fitting_distance(aspect: float) -> float:
    """Return the distance at which a sphere fills a window with the given aspect ratio.

    The unit is the radius of the sphere.
    """
    narrow = min(FOV_Y, 2 * math.atan(math.tan(FOV_Y / 2) * max(aspect, 0.1)))
    return _MARGIN / math.sin(narrow / 2)


def _may_reach(
    points: NDArray[np.float32], faces: NDArray[Any], target: NDArray[np.float64], reach: float
) -> NDArray[np.bool_]:
    """Return a mask (F,) of the faces that may intersect a cube.

    The cube is centred at `target` and has the half-width `reach`.
    """
    # Each vertex has six bits, one for each side of the cube. A bit is set if the vertex is beyond this side
    # of the cube. If all vertices of a face have the same bit set, the face is outside the cube.
    code = np.zeros(len(points), np.uint8)
    for axis in range(3):
        away = points[:, axis] - np.float32(target[axis])
        code |= (away > reach).astype(np.uint8) << (2 * axis)
        code |= (away < -reach).astype(np.uint8) << (2 * axis + 1)
    return np.asarray((code[faces[:, 0]] & code[faces[:, 1]] & code[faces[:, 2]]) == 0)


def _hits(
    triangles: NDArray[np.float64],
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    reach: float,
) -> NDArray[Any]:
    """Cast m rays in unit directions (m, 3). For each ray, return the number of triangles (n, 3, 3) that the
    ray hits.

    Rays start at `origin` and have the length `reach`.
    """
    a, b, c = (triangles[:, k] - origin for k in range(3))
    normal = np.cross(b - a, c - a)
    height = (normal * a).sum(axis=1)
    counts = np.zeros(len(directions), int)
    for row, direction in enumerate(directions):
        # The ray passes inside the triangle if the three volumes have the same sign.
        sides = np.stack([np.cross(p, q) @ direction for p, q in ((a, b), (b, c), (c, a))])
        inside = (sides > 0).all(axis=0) | (sides < 0).all(axis=0)
        along = normal @ direction
        # The distance along the ray is `height` divided by `along`. Compare the distance along the ray with
        # the limits without a division.
        counts[row] = np.count_nonzero(
            inside & (height * along > 0) & (np.abs(height) < reach * np.abs(along))
        )
    return counts


def _normals(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return up to 24 unit normals of the triangles (n, 3, 3) whose area is not 0."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.asarray(cross[length[:, 0] > 0] / length[length[:, 0] > 0])[:24]


def sphere(count: int) -> NDArray[np.float64]:
    """Return `count` unit vectors that cover the sphere evenly (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    angle = np.pi * (1 + math.sqrt(5)) * index
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0 else np.array([0.0, 0.0, 1.0])
