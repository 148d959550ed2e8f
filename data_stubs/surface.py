"""Surfaces of the tiny scenes: a coloured pebble, alone and in front of a curved wall.

Colours depend partly on the view direction, so only renderers that evaluate a model's appearance can match
the photographs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_stubs.captures import FRONT

FREQUENCY = 5
"""Number n of parts of an icosahedron's edge, which give 20 n^2 faces."""
WALL_FREQUENCY = 4
WALL_RADIUS = 9.0
WALL_REACH = 0.2
"""Cosine of the wall's angular extent.

The wall covers the view of every camera and does not extend further, because Triangle-Splatting mirrors
geometry behind a camera into the image.
"""
LIGHT = np.array([0.6, -0.5, 0.62])
"""Direction of the sheen, approximately a unit vector. Colours increase by `gloss` along this direction."""
GLOSS = 0.16


@dataclass(frozen=True)
class Surface:
    """A closed mesh with colours.

    Attributes
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
    color : (V, 3) float64
        Colours in [0.15, 0.85].
    gloss : (V,) float64
        The number added to every channel per unit of d . light, where d points from the camera to the vertex.
    light : (3,) float64
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    color: NDArray[np.float64]
    gloss: NDArray[np.float64]
    light: NDArray[np.float64]

    def seen_from(self, center: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the colours (V, 3) for a camera at `center`."""
        ray = self.vertices - center
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        return np.clip(self.color + (self.gloss * (ray @ self.light))[:, None], 0, 1)

    def turned(self, rotation: NDArray[np.float64]) -> Surface:
        """Return the surface and its light rotated about the origin."""
        return Surface(self.vertices @ rotation.T, self.faces, self.color, self.gloss, rotation @ self.light)


def pebble() -> Surface:
    """Return a bumpy ball of radius about 1 around the origin, z up."""
    directions, faces = icosphere(FREQUENCY)
    x, y, z = directions.T
    radius = 1 + 0.13 * np.sin(3 * x + 1) * np.sin(4 * y) + 0.08 * np.sin(5 * z + 2 * x)
    bands = 0.14 * np.sin(9 * z + 3 * np.sin(3 * x))[:, None] * np.array([1.0, -0.6, 0.5])
    color = np.clip(0.5 + 0.22 * directions + bands, 0.15, 0.85)
    return Surface(directions * radius[:, None], faces, color, np.full(len(x), GLOSS), LIGHT)


def walled() -> Surface:
    """Return the pebble in front of part of a large sphere. The sphere has no sheen and fills every pixel."""
    stone = pebble()
    directions, faces = icosphere(WALL_FREQUENCY)
    faces = faces[directions[faces].mean(axis=1) @ -FRONT > WALL_REACH]
    used, faces = np.unique(faces, return_inverse=True)
    directions, faces = directions[used], faces.reshape(-1, 3)
    height = directions[:, 2:]
    wall = np.where(height < -0.2, (0.42, 0.36, 0.28), (0.45, 0.55, 0.7)) + 0.12 * height
    wall = np.clip(wall + 0.05 * np.sin(4 * directions[:, :1] + 3 * directions[:, 1:2]), 0.15, 0.85)
    return Surface(
        np.concatenate([stone.vertices, WALL_RADIUS * directions]),
        np.concatenate([stone.faces, faces + len(stone.vertices)]),
        np.concatenate([stone.color, wall]),
        np.concatenate([stone.gloss, np.zeros(len(directions))]),
        stone.light,
    )


def icosphere(frequency: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return unit vectors (10 n^2 + 2, 3) and faces (20 n^2, 3), wound outwards."""
    golden = (1 + 5**0.5) / 2
    base = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    points = np.array([p[k:] + p[:k] for k in range(3) for p in base])
    near = np.linalg.norm(points[:, None] - points, axis=2) < 2.1  # edges have length 2
    corners = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    found: list[NDArray[np.float64]] = []
    numbers: dict[tuple[float, ...], int] = {}
    faces = []

    def number(face: tuple[int, int, int], a: int, b: int) -> int:
        weights = np.array([frequency - a - b, a, b]) / frequency
        point = weights @ points[list(face)]
        key = tuple(np.round(point, 6) + 0.0)
        if key not in numbers:
            numbers[key] = len(found)
            found.append(point / np.linalg.norm(point))
        return numbers[key]

    for face in corners:
        for a in range(frequency):
            for b in range(frequency - a):
                faces.append([number(face, a, b), number(face, a + 1, b), number(face, a, b + 1)])
                if a + b < frequency - 1:
                    steps = ((a + 1, b), (a + 1, b + 1), (a, b + 1))
                    faces.append([number(face, *step) for step in steps])
    vertices, result = np.array(found), np.array(faces)
    a, b, c = (vertices[result[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    result[inward] = result[inward][:, ::-1]
    return vertices, result
