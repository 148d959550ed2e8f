"""Computes smooth normals of a mesh, for files that are lit."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.meshes.mesh import Mesh

# If two faces differ by more than this angle in degrees, the edge between them is a crease. Common modelling
# programs use an angle of 30 to 60 degrees.
CREASE = 45.0


def with_smooth_normals(mesh: Mesh) -> Mesh:
    """Return `mesh` with corner normals. The normals are smooth on slightly bent surfaces and keep creases.

    The normal of a corner is an average over faces at the same place, weighted by area. The average includes
    faces whose normals differ by at most `CREASE` degrees from the normal of the corner's face. All vertices
    at one place are treated as one vertex, so that texture seams stay invisible.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    # Sort the corners (3F,) by place, so that the corners of one place form a block [start, stop).
    _, place = np.unique(mesh.vertices.astype(np.float32), axis=0, return_inverse=True)
    at = place.reshape(-1)[mesh.faces.reshape(-1)]
    order = np.argsort(at, kind="stable")
    face = order // 3
    count = np.bincount(at[order])
    start = np.repeat(np.cumsum(count) - count, count)
    size = np.repeat(count, count)
    # For each corner, visit the corners of its block and add similar normals.
    sums = np.zeros((len(order), 3))
    least = np.cos(np.radians(CREASE))
    position = np.arange(len(order)) - start
    for step in range(int(size.max(initial=0))):
        rows = np.flatnonzero(size > step)
        other = face[start[rows] + (position[rows] + step) % size[rows]]
        is_similar = np.einsum("nk,nk->n", unit[face[rows]], unit[other]) >= least
        sums[rows] += np.where(is_similar[:, None], vectors[other], 0)
    long = np.linalg.norm(sums, axis=1, keepdims=True)
    smooth = np.divide(sums, long, out=np.tile((0.0, 1.0, 0.0), (len(sums), 1)), where=long > 0)
    normals = np.zeros((len(order), 3), np.float32)
    normals[order] = smooth
    return replace(mesh, corner_normals=_round(normals))


def _round(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Round the normals to 12 bits per coordinate, so that the corners of a smooth vertex are equal.

    The normals at one vertex are added in a different order for each corner, so the sums differ by rounding
    errors.
    """
    rounded: NDArray[np.float32] = np.round(normals * 2048) / np.float32(2048)
    return rounded


def vertex_normals(mesh: Mesh) -> NDArray[np.float32]:
    """Return the unit normals (V, 3) of a mesh if all corners of each vertex have the same normal."""
    assert mesh.corner_normals is not None
    normals = np.tile(np.array((0, 1, 0), np.float32), (len(mesh.vertices), 1))
    normals[mesh.faces.reshape(-1)] = mesh.corner_normals
    length = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
    unit: NDArray[np.float32] = (normals / np.maximum(length, 1e-12)).astype(np.float32)
    return unit
