"""Rotates a mesh so that +y is up, and converts its colours to linear light."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.meshes.colors import linear_light
from msb.meshes.mesh import Mesh

# Rotations that turn an up axis to +y. An entry describes the new axes x, y and z. Each value is the index
# and the sign of an old axis. Each of the rotations has determinant +1.
_UPRIGHT: dict[str, tuple[tuple[int, int], ...]] = {
    "+y": ((0, 1), (1, 1), (2, 1)),
    "-y": ((0, 1), (1, -1), (2, -1)),
    "+z": ((0, 1), (2, 1), (1, -1)),
    "-z": ((0, 1), (2, -1), (1, 1)),
    "+x": ((1, -1), (0, 1), (2, 1)),
    "-x": ((1, 1), (0, -1), (2, 1)),
}


def rotate_upright(mesh: Mesh, up: str) -> Mesh:
    """Return `mesh` rotated so that its axis `up` becomes +y. The winding of the faces does not change."""
    return replace(mesh, vertices=rotate_axis(mesh.vertices, up), up="+y")


def rotate_axis(vertices: NDArray[Any], up: str, to: str = "+y") -> NDArray[Any]:
    """Return `vertices` (V, 3) rotated by multiples of 90 degrees so that axis `up` becomes axis `to`.

    The rotation is exact, because coordinates are only swapped and negated. If either axis is "unknown", the
    vertices are returned unchanged.
    """
    if up == to or "unknown" in (up, to):
        return vertices
    upright = [sign * vertices[:, axis] for axis, sign in _UPRIGHT[up]]
    # Apply the inverse of the rotation that makes `to` the +y axis.
    rotated = np.empty_like(vertices)
    for column, (axis, sign) in zip(upright, _UPRIGHT[to], strict=True):
        rotated[:, axis] = sign * column
    return rotated


def with_linear_colors(mesh: Mesh) -> Mesh:
    """Return `mesh` with its sRGB colours converted to linear light, as float32 in [0, 1]."""
    vertex_colors, face_colors = (
        None if colors is None else linear_light(colors) for colors in (mesh.vertex_colors, mesh.face_colors)
    )
    return replace(mesh, vertex_colors=vertex_colors, face_colors=face_colors)
