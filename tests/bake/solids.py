"""Surfaces and soups for the tests of levels of detail and of collision meshes."""

import numpy as np
from numpy.typing import NDArray

from msb.meshes.mesh import Mesh


def ball(rows: int = 16, radius: float = 1.0) -> Mesh:
    """Return a closed ball of 4 rows (rows - 1) faces, wound outwards, coloured by its places."""
    columns = 2 * rows
    up, round_ = np.meshgrid(np.pi * np.arange(1, rows) / rows, np.pi * np.arange(columns) / rows)
    ring = np.stack([np.sin(up) * np.cos(round_), np.sin(up) * np.sin(round_), np.cos(up)], axis=-1)
    points = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    number = np.arange(columns * (rows - 1)).reshape(columns, rows - 1)
    after = np.roll(number, -1, axis=0)
    a, b, c, d = number[:, :-1], number[:, 1:], after[:, 1:], after[:, :-1]
    top, bottom = np.full(columns, len(points) - 2), np.full(columns, len(points) - 1)
    faces = [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    caps = (top, number[:, 0], after[:, 0]), (bottom, after[:, -1], number[:, -1])
    faces += [np.stack(each, axis=-1) for each in caps]
    return Mesh((radius * points).astype(np.float32), np.concatenate(faces), vertex_colors=colors_at(points))


def colors_at(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return colours that change slowly from place to place."""
    return (0.5 + 0.4 * points).astype(np.float32)


def soup_of(mesh: Mesh) -> Mesh:
    """Return the faces of `mesh` with vertices of their own."""
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[mesh.faces].reshape(-1, 3)
    faces = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), faces, vertex_colors=colors)


def box(sides: tuple[float, float, float], turn: NDArray[np.float64] | None = None) -> Mesh:
    """Return a closed box about the origin, wound outwards, turned by the matrix `turn`."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * sides
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))], np.int64)
    placed = corners if turn is None else corners @ turn.T
    return Mesh(placed.astype(np.float32), faces)


def torus(rows: int = 12) -> Mesh:
    """Return a closed ring of 4 rows x rows faces, wound outwards, that is 2 wide and 0.6 high."""
    columns = 2 * rows
    round_, up = np.meshgrid(
        2 * np.pi * np.arange(columns) / columns, 2 * np.pi * np.arange(rows) / rows, indexing="ij"
    )
    out = 0.7 + 0.3 * np.cos(up)
    points = np.stack([out * np.cos(round_), out * np.sin(round_), 0.3 * np.sin(up)], axis=-1).reshape(-1, 3)
    a = np.arange(columns * rows).reshape(columns, rows)
    b, d = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    faces = [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    return Mesh(points.astype(np.float32), np.concatenate(faces))


def together(*meshes: Mesh) -> Mesh:
    """Return the faces of several meshes, without colours."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))
