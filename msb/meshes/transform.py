"""Changes of a mesh on its way into a file: turned upright, its colours made linear."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.meshes.colors import linear_light
from msb.meshes.mesh import Mesh

# Axis that is up -> rotation as (axis, sign) of the old frame for the new x, y, z; determinant +1 each.
_UPRIGHT: dict[str, tuple[tuple[int, int], ...]] = {
    "+y": ((0, 1), (1, 1), (2, 1)),
    "-y": ((0, 1), (1, -1), (2, -1)),
    "+z": ((0, 1), (2, 1), (1, -1)),
    "-z": ((0, 1), (2, -1), (1, 1)),
    "+x": ((1, -1), (0, 1), (2, 1)),
    "-x": ((1, 1), (0, -1), (2, 1)),
}


def turned_upright(mesh: Mesh, up: str) -> Mesh:
    """Return `mesh` as `turned` makes its axis `up` +y; winding is kept."""
    return replace(mesh, vertices=turned(mesh.vertices, up), up="+y")


def turned(vertices: NDArray[Any], up: str, to: str = "+y") -> NDArray[Any]:
    """Return `vertices` (V, 3) rotated by quarter turns so that axis `up` becomes `to`; "unknown", they stay.

    This is exact: coordinates are swapped and negated, never multiplied.
    """
    if up == to or "unknown" in (up, to):
        return vertices
    upright = [sign * vertices[:, axis] for axis, sign in _UPRIGHT[up]]
    made = np.empty_like(vertices)
    for column, (axis, sign) in zip(upright, _UPRIGHT[to], strict=True):
        made[:, axis] = sign * column
    return made


def with_linear_colors(mesh: Mesh) -> Mesh:
    """Return `mesh` with its sRGB colours converted to linear light, as float32 in [0, 1]."""
    colors = {"vertex_colors": mesh.vertex_colors, "face_colors": mesh.face_colors}
    return replace(mesh, **{name: linear_light(own) for name, own in colors.items() if own is not None})
