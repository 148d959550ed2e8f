"""Scenes of the standard tier's benchmark: triangles of chosen size on the screen, seen by one camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, FOCAL = 1237, 822, 1160.0
DISTANCE = 2.78
PIXEL = DISTANCE / FOCAL
"""The size of a pixel at the distance of the scenes."""


class Scene(NamedTuple):
    """A mesh with RGBA8 vertex colours. `shared` is true if faces share vertices."""

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    colors: NDArray[np.uint8]
    shared: bool


def pose() -> NDArray[np.float64]:
    """Return world_to_camera of a camera at `DISTANCE` from the scene.

    Its view direction is along no axis.
    """
    a, b = 0.3, 0.2
    about_y = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    about_x = [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(about_x) @ np.array(about_y)
    matrix[2, 3] = DISTANCE
    return matrix


def shell(count: int) -> Scene:
    """Return a soup in a thick spherical shell.

    The shell covers half of the image, whatever the number of triangles is. Corners are scattered around the
    centre of a triangle. The standard deviation is 3.5 pixels for 100 thousand triangles, 1.1 for a million
    and 0.55 for 4 million. Triangles are in random order.
    """
    random = np.random.default_rng(0)
    center = random.normal(size=(count, 3))
    center /= np.linalg.norm(center, axis=1, keepdims=True)
    center *= np.cbrt(random.uniform(0.6**3, 1, (count, 1)))
    size = 3.5 * np.sqrt(1e5 / count) * PIXEL
    return _soup(random, center[:, None] + size * random.normal(size=(count, 3, 3)))


def large(count: int) -> Scene:
    """Return overlapping triangles of about 200 pixels."""
    random = np.random.default_rng(0)
    center = random.uniform(-0.8, 0.8, (count, 1, 3))
    return _soup(random, center + 200 * PIXEL * random.normal(size=(count, 3, 3)))


def spheres(count: int) -> Scene:
    """Return three bumpy spheres inside one another. Faces share vertices and are in random order."""
    random = np.random.default_rng(0)
    n = int(np.sqrt(count / 12))
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * n + 1), np.linspace(0.01, np.pi - 0.01, n + 1))
    at = (np.arange(n)[:, None] * (2 * n + 1) + np.arange(2 * n)).reshape(-1, 1)
    row = 2 * n + 1
    patch = np.concatenate([at + np.array(corners) for corners in ((0, 1, row), (1, row + 1, row))])
    layers = []
    for k in range(3):
        radius = 1 - 0.15 * k + 0.05 * np.sin(5 * u + k) * np.sin(4 * v)
        xyz = radius * np.sin(v) * np.cos(u), radius * np.cos(v), radius * np.sin(v) * np.sin(u)
        layers.append(np.stack(xyz, axis=-1).reshape(-1, 3))
    positions = np.concatenate(layers)
    indices = np.concatenate([patch + k * len(layers[0]) for k in range(3)])
    moved = random.permutation(len(positions))
    place = np.zeros(len(positions), np.uint32)
    place[moved] = np.arange(len(positions), dtype=np.uint32)
    indices = place[random.permutation(indices)]
    return Scene(positions[moved].astype(np.float32), indices, _colors(random, len(positions)), True)


def _soup(random: np.random.Generator, triangles: NDArray[Any]) -> Scene:
    positions = triangles.reshape(-1, 3).astype(np.float32)
    indices = np.arange(len(positions), dtype=np.uint32).reshape(-1, 3)
    return Scene(positions, indices, _colors(random, len(positions)), False)


def _colors(random: np.random.Generator, count: int) -> NDArray[np.uint8]:
    colors = random.integers(0, 256, (count, 4), dtype=np.uint8)
    colors[:, 3] = 255
    return colors


SCENES: dict[str, tuple[str, Callable[[], Scene]]] = {
    "shell-100k": ("soup of 100,000 triangles of about 4 pixels", lambda: shell(100_000)),
    "shell-1M": ("soup of 1,000,000 of about a pixel", lambda: shell(1_000_000)),
    "shell-4M": ("soup of 4,000,000 of about half a pixel", lambda: shell(4_000_000)),
    "large": ("3,000 overlapping triangles of about 200 pixels", lambda: large(3_000)),
    "spheres-1M": (
        "mesh of 1,000,000 faces that share vertices, two thirds hidden",
        lambda: spheres(1_000_000),
    ),
    "spheres-4M": ("the same of 4,000,000 faces", lambda: spheres(4_000_000)),
}
"""For each scene name, the description and the function that creates the scene."""
