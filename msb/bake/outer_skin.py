"""An outer skin makes the surface of an interior a solid with walls.

The surface of a scene encloses the free space around the cameras. Therefore the faces of the surface look
inwards, and its volume is negative. Booleans, 3D printing and physics need a solid with a positive volume.
The skin is a second closed surface around the first surface, with faces that look outwards.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from msb.bake.arrays import Floats, Ints
from msb.bake.simplification import is_closed_surface
from msb.meshes.mesh import Mesh
from msb.topology.faces import signed_volume

# The skin is an icosahedron after this number of subdivisions: 642 directions, 1,280 faces, edges of 8
# degrees.
_SUBDIVISIONS = 3
# Angle in radians between neighbouring sample points of a face. This angle is smaller than the angle between
# neighbouring directions, so that a face is found in every direction.
_MAX_STEP = 0.07
# Largest number of rounds that halve the edges of faces. The new corners are sample points.
_MAX_ROUNDS = 6
# Colour of the skin, which no view sees: a neutral grey.
_GREY = 128


def is_interior(mesh: Mesh) -> bool:
    """Return whether a mesh is closed and wound inwards."""
    is_inward = signed_volume(mesh.vertices, mesh.faces) < 0
    return is_inward and is_closed_surface(mesh.vertices, mesh.faces)


def add_outer_skin(mesh: Mesh, thickness: float) -> Mesh:
    """Append an outer skin to the vertices and faces of `mesh`, and return the result.

    For each direction from the middle, find the farthest point of the surface. In each direction, the skin
    lies behind the farthest point. The distance between the skin and this point is `thickness` times the
    distance from the middle to the point. The skin is grey, or the colour of a single texel for a textured
    mesh.
    """
    points = mesh.vertices.astype(np.float64)
    middle = np.median(points[np.unique(mesh.faces)], axis=0)
    directions, faces = _make_sphere()
    radius = (1 + thickness) * _find_farthest(points[mesh.faces] - middle, directions, faces)
    skin = (middle + radius[:, None] * directions).astype(mesh.vertices.dtype)
    count, corners = len(skin), 3 * len(faces)
    rows: dict[str, Any] = {
        "vertices": np.concatenate([mesh.vertices, skin]),
        "faces": np.concatenate([mesh.faces, faces + len(points)]),
    }
    if (colors := mesh.vertex_colors) is not None:
        grey = np.full((count, colors.shape[1]), _GREY if colors.dtype == np.uint8 else 0.5, colors.dtype)
        rows["vertex_colors"] = np.concatenate([colors, grey])
    if mesh.corner_uvs is not None:
        rows["corner_uvs"] = np.concatenate([mesh.corner_uvs, np.tile(mesh.corner_uvs[:1], (corners, 1))])
    return replace(mesh, **rows)


def _make_sphere() -> tuple[Floats, Ints]:
    """Return the unit vectors (V, 3) and faces (F, 3) of a subdivided icosahedron, wound outwards."""
    golden = (1 + np.sqrt(5)) / 2
    rectangle = np.array([[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0]])
    points = np.concatenate([np.roll(rectangle, turn, axis=1) for turn in range(3)])
    # The faces are the triples of corners with the smallest distances from each other.
    near = np.isclose(np.linalg.norm(points[:, None] - points, axis=2), 2)
    faces = np.array(
        [
            (a, b, c)
            for a in range(12)
            for b in range(a + 1, 12)
            for c in range(b + 1, 12)
            if near[a, b] and near[b, c] and near[c, a]
        ]
    )
    inward = (
        np.einsum("fk,fk->f", np.cross(points[faces[:, 1]], points[faces[:, 2]]), points[faces[:, 0]]) < 0
    )
    faces[inward] = faces[inward][:, ::-1]
    for _ in range(_SUBDIVISIONS):
        # Halve the edges. `number` (3F,) is the index of the new point in the middle of each side.
        sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        ends, number = np.unique(sides, axis=0, return_inverse=True)
        ab, bc, ca = (len(points) + number.reshape(-1, 3)).T
        a, b, c = faces.T
        points = np.concatenate([points, points[ends].sum(axis=1)])
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return points / np.linalg.norm(points, axis=1, keepdims=True), faces.astype(np.int64)


def _find_farthest(corners: Floats, directions: Floats, faces: Ints) -> Floats:
    """Return the largest distance (V,) of face corners (F, 3, 3) around each direction (V, 3).

    Each direction gets the maximum of its own distance and the distances of the neighbouring directions. A
    direction without points gets the largest distance of all directions.
    """
    from scipy.spatial import cKDTree

    # Split faces that span a large angle. The new corners then sample the faces densely enough.
    samples = [corners.reshape(-1, 3)]
    for _ in range(_MAX_ROUNDS):
        unit = corners / np.maximum(np.linalg.norm(corners, axis=2, keepdims=True), 1e-300)
        sides = np.linalg.norm(unit - np.roll(unit, -1, axis=1), axis=2)
        corners = corners[(sides > _MAX_STEP).any(axis=1)]
        if not len(corners):
            break
        a, b, c = corners.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        samples.append(corners.reshape(-1, 3))
    points = np.concatenate(samples)
    length = np.linalg.norm(points, axis=1)
    points, length = points[length > 0], length[length > 0]
    nearest = cKDTree(directions).query(points / length[:, None])[1]
    radius = np.zeros(len(directions))
    np.maximum.at(radius, nearest, length)
    radius[radius == 0] = length.max()
    # Take the maximum over neighbouring directions, so that the faces of the skin lie behind all points.
    largest = radius.copy()
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    np.maximum.at(largest, sides[:, 0], radius[sides[:, 1]])
    np.maximum.at(largest, sides[:, 1], radius[sides[:, 0]])
    return largest
