"""Fairing: smooth dents of a surface away, and keep its creases.

The normals of the faces are averaged over similar normals around them. The vertices then move so that the
faces follow the filtered normals (Sun et al. 2007, Zheng et al. 2011). Without this step a lit surface looks
like crumpled paper, because the depths of a fitted soup are uneven.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from msb.bake.arrays import Floats, Ints
from msb.bake.closed_mesh import make_neighbour_average
from msb.topology.faces import face_vectors

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# Width of the filter of normals, as a length of the difference of two unit normals. Normals that differ by 30
# degrees (0.52) have a weight of 0.59, and at a crease of 90 degrees (1.41) the weight is 0.02.
_NORMAL_WIDTH = 0.5
# Turns of `fair`. Each turn filters the normals and moves the vertices. After ten turns the dents of the demo
# surfaces are gone, and further turns round their rims.
_TURNS = 10
# Shares of the way to the average of the neighbours in the two halves of a turn of `smooth`.
_SHARES = 0.5, -0.53
# A face is folded if the cosine of an angle is below this limit: the angle between its normal and the sum of
# the normals around it, weighted by area. At the rim of a thin sheet, the sum includes both sides, and the
# cosine is near 0.
_FOLDED = -0.3
# Smallest length of that sum, relative to the sum of the lengths.
_AGREEMENT = 0.5
# Number of faces of the surface per turn, up to all turns. In a coarse surface, faces are as large as the
# shapes themselves: a level of detail of 1,000 faces gained 0.8 dB with 500 instead of 50.
_FACES_PER_TURN = 500
# Rounds of the filter, and rounds of moving the vertices, in a turn of `fair`.
_FILTER_ROUNDS, _MOVE_ROUNDS = 3, 3


class Neighbours(NamedTuple):
    """The faces around each face: those that share a vertex with it, and the face itself.

    The neighbours of face i are ``faces[starts[i]:starts[i + 1]]``; `owner` (n,) is i for each of them.
    """

    owner: Ints
    faces: Ints
    starts: Ints


def find_neighbours(faces: Ints, count: int) -> Neighbours:
    """Return the neighbours of the faces (F, 3) of a mesh with `count` vertices."""
    from scipy.sparse import csr_matrix

    # has (V, F) is 1 where a face has a vertex, so has^T has (F, F) is positive for faces that share one.
    rows, columns = faces.reshape(-1), np.repeat(np.arange(len(faces)), 3)
    has = csr_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, len(faces)))
    pairs = (has.T @ has).tocsr()
    starts = pairs.indptr.astype(np.int64)
    return Neighbours(np.repeat(np.arange(len(faces)), np.diff(starts)), pairs.indices, starts)


def smooth(points: Floats, faces: Ints, turns: int) -> Floats:
    """Return the points (V, 3) of a surface after `turns` turns of smoothing that keep its volume.

    A turn moves each vertex towards the average of its neighbours, then away from it (Taubin 1995). It
    removes the noise of single cells.
    """
    average = make_neighbour_average(faces, len(points))
    for _ in range(turns):
        for share in _SHARES:
            points = points + share * (average @ points - points)
    return points


def fair(points: Floats, faces: Ints) -> Floats:
    """Return the points (V, 3) of a surface after some turns of filtering normals and moving vertices.

    A surface of few faces has no dents that are small next to the whole, so it is faired less or not at all.
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
    """Return the points (V, 3) with folded faces opened.

    A folded face lies upside down between its neighbours. The filter cannot turn it, as its normal differs
    too much from theirs. Its corners move half way to the average of their neighbours instead.
    """
    vectors = face_vectors(points, faces)
    length = np.linalg.norm(vectors, axis=1)
    sums = np.add.reduceat(vectors[neighbours.faces], neighbours.starts[:-1]) - vectors
    total = np.add.reduceat(length[neighbours.faces], neighbours.starts[:-1]) - length
    sum_length = np.linalg.norm(sums, axis=1)
    # The normals around a folded face agree with each other. Those around a face of a tetrahedron do not.
    is_folded = np.einsum("fk,fk->f", vectors, sums) < _FOLDED * length * sum_length
    is_folded &= sum_length > _AGREEMENT * total
    moved = np.zeros(len(points), bool)
    moved[faces[is_folded]] = True
    result = points.copy()
    result[moved] = ((points + average @ points) / 2)[moved]
    return result


def filter_normals(points: Floats, faces: Ints, neighbours: Neighbours, rounds: int) -> Floats:
    """Return the filtered unit normals (F, 3) of the faces.

    In each round n_i becomes the unit vector of sum_j A_j exp(-|c_i - c_j|^2 / 2 s_i^2 - |n_i - n_j|^2 / 2
    s_n^2) n_j over the neighbours j, with areas A, centres c, s_n = `_NORMAL_WIDTH`, and s_i^2 the average
    squared distance of the centres around face i.
    """
    owner, others, starts = neighbours
    vectors = face_vectors(points, faces)
    length = np.linalg.norm(vectors, axis=1)
    normals = vectors / np.maximum(length, 1e-300)[:, None]
    # The weights (n,) of the pairs by area and distance do not change between rounds.
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
    """Return the points (V, 3), moved so that the faces turn towards the unit `normals` (F, 3).

    A vertex v moves by `share` of the average over its faces of n (n . (c - v)), where n is the normal and c
    the centre of a face: towards the plane through the centre.
    """
    corners = points[faces]
    offsets = np.einsum("fk,fck->fc", normals, corners.mean(axis=1)[:, None] - corners)
    moves = (offsets[:, :, None] * normals[:, None]).reshape(-1, 3)
    index = faces.reshape(-1)
    sums = np.stack([np.bincount(index, moves[:, axis], len(points)) for axis in range(3)], axis=1)
    count = np.bincount(index, minlength=len(points))
    result: Floats = points + share * sums / np.maximum(count, 1)[:, None]
    return result
