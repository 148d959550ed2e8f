"""Changes that `msb convert` can make to a mesh: turn it upright, make its colours linear."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
    """Return `mesh` rotated by quarter turns so that its axis `up` becomes +y.

    This is exact: coordinates are swapped and negated, never multiplied. Winding is kept.

    Parameters
    ----------
    up : {"+x", "-x", "+y", "-y", "+z", "-z"}
    """
    columns = [sign * mesh.vertices[:, axis] for axis, sign in _UPRIGHT[up]]
    return replace(mesh, vertices=np.stack(columns, axis=1))


def with_linear_colors(mesh: Mesh) -> Mesh:
    """Return `mesh` with its sRGB colours converted to linear light, as float32 in [0, 1]."""
    return replace(mesh, vertex_colors=_linear(mesh.vertex_colors), face_colors=_linear(mesh.face_colors))


def _linear(colors: NDArray[Any] | None) -> NDArray[np.float32] | None:
    """Return linear colours (IEC 61966-2-1); a fourth column is alpha, which is linear already."""
    if colors is None:
        return None
    scale = 255.0 if colors.dtype == np.uint8 else 1.0
    values = colors.astype(np.float64) / scale
    rgb = values[:, :3]
    values[:, :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0) + 0.055) / 1.055) ** 2.4)
    return values.astype(np.float32)
