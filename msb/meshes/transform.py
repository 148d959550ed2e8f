"""Changes of a mesh on its way into a file: turned upright, its colours made linear."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import srgb_to_linear
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
    return replace(mesh, vertex_colors=_linear(mesh.vertex_colors), face_colors=_linear(mesh.face_colors))


def _linear(colors: NDArray[Any] | None) -> NDArray[np.float32] | None:
    """Return linear colours; a fourth column is alpha, which is linear already."""
    if colors is None:
        return None
    values = colors / (255.0 if colors.dtype == np.uint8 else 1.0)
    values[:, :3] = srgb_to_linear(values[:, :3])
    return values.astype(np.float32)
