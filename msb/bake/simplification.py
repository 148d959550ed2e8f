"""Face reduction by quadric error that keeps a closed surface closed, manifold and consistently wound."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints
from msb.bake.closed_mesh import repair_closed
from msb.topology import audit_arrays
from msb.topology.seams import is_closed
from msb.topology.steps import drop, turn_faces

# Growth of the allowed error per pass of fast_simplification (the parameter `agg`). The default value of the
# library is 7. Slower growth preserves the shape better, but the result may exceed the face budget.
_AGGRESSIVENESS = 5


def is_closed_surface(points: NDArray[Any], faces: Ints) -> bool:
    """Return whether a surface is closed, manifold and consistently wound."""
    return is_closed(audit_arrays(points, faces, check_crossings=False)[0].counts)


def simplify(points: Floats, faces: Ints, count: int) -> tuple[Floats, Ints]:
    """Reduce a surface to about `count` faces. Return points (V, 3) and faces (F, 3).

    A closed surface stays closed, manifold and consistently wound. If no face would remain, more than `count`
    faces are kept. An open surface loses surplus faces at edges with more than two faces.
    """
    import fast_simplification

    repair = repair_closed if is_closed_surface(points, faces) else _make_manifold
    # Scale the surface to a size of 1, because fast_simplification drops very small faces.
    middle, size = points[faces].mean(axis=(0, 1)), float(np.ptp(points[faces], axis=(0, 1)).max()) or 1.0
    unit = (points - middle) / size
    while count < len(faces):
        fewer, chosen = fast_simplification.simplify(
            unit, faces.astype(np.int32), target_count=count, agg=_AGGRESSIVENESS
        )
        # In a file, different coordinates may become equal float32 numbers. Round the coordinates now, so
        # that such points are repaired here.
        placed = (middle + size * fewer).astype(np.float32).astype(np.float64)
        result = repair(placed, chosen.astype(np.int64))
        if len(result[1]):
            return result
        count *= 2
    return points, faces


def _make_manifold(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface without degenerate faces, and with at most two faces at each edge.

    The winding is made consistent as far as possible.
    """
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    change = drop(points, faces)
    points, faces = points[change.vertex_map], change.faces.astype(np.int64)
    return points, turn_faces(faces, len(points)).faces.astype(np.int64)
