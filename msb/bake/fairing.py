"""Fairing smooths dents of a surface and keeps its creases.

Each face normal is averaged with the similar normals around it. The vertices then move so that the faces
follow the filtered normals (Sun et al. 2007, Zheng et al. 2011). Without fairing, a lit surface would look
crumpled, because the depths of a fitted soup are uneven.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from msb.bake.arrays import Floats, Ints
from msb.bake.closed_mesh import make_neighbour_average
from msb.topology.faces import face_vectors

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# Width of the normal filter, as the length of the difference between two unit normals. With this width,
# normals that differ by 30 degrees (a length of 0.52) have a weight of 0.59. Normals across a crease of 90
# degrees (1.41) have a weight of 0.02.
_NORMAL_WIDTH = 0.5
# Turns of `fair`. Each turn of fairing filters the normals and moves the vertices. After ten turns, the dents
# of the demo surfaces are gone. Further turns would round the rims.
_TURNS = 10
# In one smoothing turn, a vertex moves towards the average of its neighbours, then away from the average. The
# values are these two moves, as shares of the distance to the average.
_SHARES = 0.5, -0.53
# A face is folded if its normal points away from the normals around it. The limit applies to the cosine
# between the normal and the area-weighted sum of the surrounding normals. The limit is negative because of
# thin sheets: at their rim, the surrounding normals point in opposite directions, and the cosine is near 0.
_FOLDED = -0.3
# The surrounding normals disagree if the length of their sum, relative to the sum of their lengths, is below
# this limit.
_AGREEMENT = 0.5
# The number of fairing turns is the number of faces divided by this value, up to `_TURNS`. In a coarse
# surface, faces are as large as the shapes themselves. A level of detail with 1,000 faces gained 0.8 dB with
# a value of 500 instead of 50.
_FACES_PER_TURN = 500
# Number of filter rounds, and number of rounds that move the vertices, in one turn of `fair`.
_FILTER_ROUNDS, _MOVE_ROUNDS = 3, 3


class Neighbours(NamedTuple):
    """The faces around each face: all faces that share a vertex with the face, and the face itself.

    The neighbours of face i are ``faces[starts[i]:starts[i + 1]]``. `owner` (n,) repeats the index i for each
    neighbour of face i.
    """

    owner: Ints
    faces: Ints
    starts: Ints


def find_neighbours(faces: Ints, count: int) -> Neighbours:
    """Return the neighbours of the faces (F, 3) of a mesh with `count` vertices."""
    from scipy.sparse import csr_matrix

    # The matrix `has` (V, F) marks the faces of each vertex. The product `has.T @ has` (F, F) is positive for
    # faces that share a vertex.
    rows, columns = faces.reshape(-1), np.repeat(np.arange(len(faces)), 3)
    has = csr_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, len(faces)))
    pairs = (has.T @ has).tocsr()
    starts = pairs.indptr.astype(np.int64)
    return Neighbours(np.repeat(np.arange(len(faces)), np.diff(starts)), pairs.indices, starts)


def smooth(points: Floats, faces: Ints, turns: int) -> Floats:
    """Return the points (V, 3) of a surface after `turns` turns of volume-preserving smoothing.

    A turn of smoothing moves each vertex towards the average of its neighbours, then away from the average
    (Taubin 1995). Smoothing removes the noise of single grid cells.
    """
    average = make_neighbour_average(faces, len(points))
    for _ in range(turns):
        for share in _SHARES:
            points = points + share * (average @ points - points)
    return points


def fair(points: Floats, faces: Ints) -> Floats:
    """Fair a surface: filter the normals, and move the vertices, in several turns. Return the points (V, 3).

    A surface with few faces has few small dents. Such a surface therefore gets fewer turns of fairing, or
    none.
    """
    neighbours = find_neighbours(faces, len(points))
    average = make_neighbour_average(faces, len(points))
    for _ in range(min(_TURNS, len(faces) // _FACES_PER_TURN)):
        points = _unfold(points, faces, neighbours, average)
        normals = filter_normals(points, faces, neighbours, _FILTER_ROUNDS)
        for _ in range(_MOVE_ROUNDS):
            points = follow_normals(points, faces, normals)
    return points


def _unfold(points: Floats, faces: Ints, neighbours: Neighbours, average: csr_matrix) -> Floats:
    """Unfold faces that are upside down. Return the points (V, 3).

    A folded face lies upside down between its neighbours. The filter of normals cannot turn a folded face,
    because its normal differs too much from the normals around it. The corners of a folded face move half way
    to the average of their neighbours.
    """
    vectors = face_vectors(points, faces)
    length = np.linalg.norm(vectors, axis=1)
    sums = np.add.reduceat(vectors[neighbours.faces], neighbours.starts[:-1]) - vectors
    total = np.add.reduceat(length[neighbours.faces], neighbours.starts[:-1]) - length
    sum_length = np.linalg.norm(sums, axis=1)
    # Around a folded face, the normals of the neighbours agree with each other. The normals around a face of
    # a tetrahedron disagree.
    is_folded = np.einsum("fk,fk->f", vectors, sums) < _FOLDED * length * sum_length
    is_folded &= sum_length > _AGREEMENT * total
    moved = np.zeros(len(points), bool)
    moved[faces[is_folded]] = True
    result = points.copy()
    result[moved] = ((points + average @ points) / 2)[moved]
    return result


def filter_normals(points: Floats, faces: Ints, neighbours: Neighbours, rounds: int) -> Floats:
    """Filter the unit normals (F, 3) of the faces.

    In each round n_i becomes the unit vector of sum_j A_j exp(-|c_i - c_j|^2 / 2 s_i^2 - |n_i - n_j|^2 / 2
    s_n^2) n_j over the neighbours j. A are the areas and c the centres of the faces, s_n = `_NORMAL_WIDTH`,
    and s_i^2 is the average squared distance of the neighbouring centres from c_i.
    """
    owner, others, starts = neighbours
    vectors = face_vectors(points, faces)
    length = np.linalg.norm(vectors, axis=1)
    normals = vectors / np.maximum(length, 1e-300)[:, None]
    # The area and distance weights (n,) of the pairs do not change between rounds.
    centers = points[faces].mean(axis=1)
    squares = np.square(centers[owner] - centers[others]).sum(axis=1)
    average = np.add.reduceat(squares, starts[:-1]) / np.diff(starts)
    near = length[others] * np.exp(-squares / np.maximum(2 * average[owner], 1e-300))
    for _ in range(rounds):
        # For unit vectors |n_i - n_j|^2 = 2 - 2 n_i . n_j.
        cosine = np.einsum("nk,nk->n", normals[owner], normals[others])
        weights = near * np.exp((cosine - 1) / _NORMAL_WIDTH**2)
        sums = np.add.reduceat(weights[:, None] * normals[others], starts[:-1])
        size = np.linalg.norm(sums, axis=1, keepdims=True)
        normals = np.where(size > 0, sums / np.maximum(size, 1e-300), normals)
    result: Floats = normals
    return result


def follow_normals(points: Floats, faces: Ints, normals: Floats, share: float = 1.0) -> Floats:
    """Move the points (V, 3) so that the faces turn towards the unit `normals` (F, 3). Return the points.

    A vertex v moves towards the planes of its adjacent faces. A face with the normal n and the centre c
    contributes n dot(n, c - v). The vertex moves by `share` times the average contribution of its faces.
    """
    corners = points[faces]
    offsets = np.einsum("fk,fck->fc", normals, corners.mean(axis=1)[:, None] - corners)
    moves = (offsets[:, :, None] * normals[:, None]).reshape(-1, 3)
    index = faces.reshape(-1)
    sums = np.stack([np.bincount(index, moves[:, axis], len(points)) for axis in range(3)], axis=1)
    count = np.bincount(index, minlength=len(points))
    result: Floats = points + share * sums / np.maximum(count, 1)[:, None]
    return result
