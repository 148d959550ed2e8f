"""Generate meshes with the structure of trained MeshSplatting exports, at any size.

MeshSplatting keeps faces of a 3D Delaunay tetrahedralisation near a surface. This generator uses the integer
lattice instead, with each cube cut into six Kuhn tetrahedra along its main diagonal. It labels each
tetrahedron as inside or outside of a sphere, with noise. It keeps most faces between different labels, and
some stray faces close to the sphere. Labels and decisions come from a hash of the element. Therefore nothing
is stored, and one pass over the cubes near the surface is enough for any size. n^3 cubes give about 26.6 n^2
faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

RADIUS = 0.36
"""The radius of the sphere, in units of the cube's side."""
JITTER = 0.1
"""The greatest displacement of a lattice point, in lattice steps."""

ORDERINGS = list(permutations(range(3)))
"""The six tetrahedra of a cube. Their corners are b and the points after each step along these axes."""


@dataclass(frozen=True)
class Shape:
    """Parameters fitted to the paper's mean row of mesh diagnostics.

    Attributes
    ----------
    noise : float
        Standard deviation of the label noise, in lattice steps.
    drop : float
        Probability that a face between different labels is left out.
    stray : float
        Probability that any other face near the surface is kept.
    reach : float
        How near to the surface stray faces lie, in lattice steps.
    """

    noise: float = 0.8
    drop: float = 0.08
    stray: float = 0.07
    reach: float = 4.0


def splat_like(
    n: int, *, seed: int = 0, shape: Shape | None = None, shuffle: bool = True
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return vertices (V, 3) in the unit cube and faces (F, 3) of a mesh on a lattice of n^3 cubes.

    36 cubes along each side give about 35 thousand faces, 194 cubes one million, and 388 cubes four million.
    As after a training, vertices and faces are in random order, and the corners of each face are rotated at
    random, unless `shuffle` is false.
    """
    shape = shape or Shape()
    cubes = _cubes_near_surface(n, shape)
    parts = [_faces_of_chains(n, seed, shape, cubes, a, b) for a, b in _chains()]
    faces = np.concatenate([part[keep] for part, keep in parts])
    used, flat = np.unique(faces, return_inverse=True)
    faces = flat.reshape(-1, 3).astype(np.int32)
    lattice = np.stack(np.unravel_index(used, (n + 1,) * 3), axis=1)
    wobble = np.stack([_uniform(used, seed + 11 + axis) for axis in range(3)], axis=1)
    vertices = (lattice + JITTER * (2 * wobble - 1)) / n
    if shuffle:
        random = np.random.default_rng(seed)
        order = random.permutation(len(vertices))
        place = np.argsort(order).astype(np.int32)
        vertices, faces = vertices[order], place[faces]
        faces = faces[random.permutation(len(faces))]
        turn = random.integers(0, 3, len(faces))
        faces = np.take_along_axis(faces, (np.arange(3) + turn[:, None]) % 3, axis=1)
    return np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.int32)


def _cubes_near_surface(n: int, shape: Shape) -> NDArray[np.int64]:
    """Return the (c, 3) corners of the cubes that can hold a kept face."""
    margin = (max(shape.reach, 5 * shape.noise) + 3) / n
    slabs = []
    axis = (np.arange(n) + 0.5) / n - 0.5
    plane = np.add.outer(axis**2, axis**2)
    for x in range(n):
        distance = np.abs(np.sqrt(plane + axis[x] ** 2) - RADIUS)
        y, z = np.nonzero(distance < margin)
        slabs.append(np.stack([np.full(len(y), x), y, z], axis=1))
    return np.concatenate(slabs)


def _chains() -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return the twelve pairs (A, B) of disjoint non-empty sets of axes; faces are (b, b + A, b + A + B)."""
    sets = [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2)]
    return [(a, b) for a in sets for b in sets if not set(a) & set(b)]


def _faces_of_chains(
    n: int,
    seed: int,
    shape: Shape,
    base: NDArray[np.int64],
    a: tuple[int, ...],
    b: tuple[int, ...],
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the faces of one pair of axis sets at every base b, and which of these faces are kept."""
    step_a, step_b = _step(a), _step(b)
    points = [base, base + step_a, base + step_a + step_b]
    faces = np.stack([_vertex_id(p, n) for p in points], axis=1)
    (cube1, order1), (cube2, order2) = _neighbours(base, a, b)
    label1, near = _label(cube1, order1, n, seed, shape)
    label2, _ = _label(cube2, order2, n, seed, shape)
    inside = (cube2 >= 0).all(axis=1)
    chain = _chains().index((a, b))
    dice = _uniform(_vertex_id(base, n) * 12 + chain, seed + 7)
    boundary = (label1 != label2) & (dice >= shape.drop)
    stray = near & (_uniform(_vertex_id(base, n) * 12 + chain, seed + 8) < shape.stray)
    return faces, inside & (boundary | stray)


def _neighbours(
    base: NDArray[np.int64], a: tuple[int, ...], b: tuple[int, ...]
) -> tuple[tuple[NDArray[np.int64], int], tuple[NDArray[np.int64], int]]:
    """Return cube and ordering of the two tetrahedra at the face (b, b + A, b + A + B)."""
    if len(a) + len(b) == 3:
        pair = a if len(a) == 2 else b
        other = (pair[1], pair[0])
        first = (*pair, *b) if pair is a else (*a, *pair)
        second = (*other, *b) if pair is a else (*a, *other)
        return (base, ORDERINGS.index(first)), (base, ORDERINGS.index(second))
    third = 3 - a[0] - b[0]
    below = base - _step((third,))
    return (
        (base, ORDERINGS.index((a[0], b[0], third))),
        (below, ORDERINGS.index((third, a[0], b[0]))),
    )


def _label(
    cube: NDArray[np.int64], ordering: int, n: int, seed: int, shape: Shape
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether each tetrahedron is inside, and whether it is within reach of the surface."""
    x, y, _ = ORDERINGS[ordering]
    centroid = np.full(3, 0.25)
    # Mean of b, b + e_x, b + e_x + e_y, b + (1, 1, 1).
    centroid[x], centroid[y] = 0.75, 0.5
    phi = (np.linalg.norm((cube + centroid) / n - 0.5, axis=1) - RADIUS) * n
    key = (_vertex_id(cube + 1, n + 2) * 6 + ordering).astype(np.int64)
    u, v = _uniform(key, seed + 1), _uniform(key, seed + 2)
    normal = np.sqrt(-2 * np.log(1 - u)) * np.cos(2 * np.pi * v)
    return phi + shape.noise * normal < 0, np.abs(phi) < shape.reach


def _step(axes: tuple[int, ...]) -> NDArray[np.int64]:
    return np.isin(np.arange(3), axes).astype(np.int64)


def _vertex_id(points: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    side = n + 1
    return np.asarray((points[:, 0] * side + points[:, 1]) * side + points[:, 2])


def _uniform(key: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
    """Return numbers in [0, 1) that depend only on `key` and `seed`, by the finaliser of SplitMix64."""
    with np.errstate(over="ignore"):
        z = key.astype(np.uint64) + np.uint64(seed + 1) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return (z >> np.uint64(11)) * (1.0 / (1 << 53))
