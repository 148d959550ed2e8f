"""Hostile meshes of any size for the audit. Each mesh is the worst case for one kind of algorithm."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    Mesh = tuple[int, NDArray[Any]]


def star(count: int) -> Mesh:
    """All faces share one vertex; their other vertices are random."""
    faces = np.random.default_rng(0).integers(1, count // 2, (count, 3))
    faces[:, 0] = 0
    return count // 2, faces


def fan(count: int) -> Mesh:
    """All faces share one vertex and form one fan around it."""
    rim = np.arange(1, count + 1)
    return count + 2, np.stack([np.zeros_like(rim), rim, rim + 1], axis=1)


def book(count: int) -> Mesh:
    """All faces share one edge."""
    page = np.arange(2, count + 2)
    return count + 2, np.stack([np.zeros_like(page), np.ones_like(page), page], axis=1)


def same(count: int) -> Mesh:
    """All faces are the same."""
    return 3, np.tile([0, 1, 2], (count, 1))


def soup(count: int) -> Mesh:
    """No two faces share a vertex."""
    return 3 * count, np.arange(3 * count).reshape(-1, 3)


def strip(count: int) -> Mesh:
    """One strip of triangles, in order."""
    first = np.arange(count)
    return count + 2, np.stack([first, first + 1, first + 2], axis=1)


def shuffled_strip(count: int) -> Mesh:
    """One strip with faces and vertices in random order.

    Algorithms that join neighbours must follow long paths.
    """
    random = np.random.default_rng(0)
    return count + 2, random.permutation(count + 2)[strip(count)[1][random.permutation(count)]]


def noise(count: int) -> Mesh:
    """Faces of three random vertices."""
    return count // 2, np.random.default_rng(0).integers(0, count // 2, (count, 3))


def few(count: int) -> Mesh:
    """Faces of three random vertices out of thirty; no face uses the other vertices."""
    return count // 2, np.random.default_rng(0).integers(0, 30, (count, 3))


def collapsed(count: int) -> Mesh:
    """Every face has a repeated index."""
    faces = np.random.default_rng(0).integers(0, count // 2, (count, 3))
    faces[:, 1] = faces[:, 0]
    return count // 2, faces


HOSTILE: dict[str, Callable[[int], Mesh]] = {
    make.__name__: make
    for make in (star, fan, book, same, soup, strip, shuffled_strip, noise, few, collapsed)
}


def hostile(name: str, count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return randomly placed vertices and `count` faces."""
    vertices, faces = HOSTILE[name](count)
    points = np.random.default_rng(1).random((vertices, 3), np.float32)
    return points, np.ascontiguousarray(faces, np.int32)
