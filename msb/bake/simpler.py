"""A surface of fewer faces, by quadric error, that is as closed, manifold and oriented as it was."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints
from msb.bake.solid import mended
from msb.topology import audit_arrays
from msb.topology.seams import is_closed
from msb.topology.steps import drop, turn_faces

# Growth of the allowed error; the library's default is 7, and slower ones end above the face budget.
_HASTE = 5


def closed(points: NDArray[Any], faces: Ints) -> bool:
    """Return whether a surface is closed, manifold and consistently wound."""
    return is_closed(audit_arrays(points, faces)[0].counts)


def simpler(points: Floats, faces: Ints, count: int) -> tuple[Floats, Ints]:
    """Return a surface of about `count` faces, no more than it has.

    A closed one stays closed, manifold and consistently wound: where so few faces leave nothing of it, it
    keeps more. Of an open one, faces go that make edges of more than two.
    """
    import fast_simplification

    mend = mended if closed(points, faces) else _manifold
    middle, size = points[faces].mean(axis=(0, 1)), float(np.ptp(points[faces], axis=(0, 1)).max()) or 1.0
    unit = (points - middle) / size  # the library takes what is very small for nothing
    while count < len(faces):
        fewer, chosen = fast_simplification.simplify(
            unit, faces.astype(np.int32), target_count=count, agg=_HASTE
        )
        # As float32 has it, which is what is written: two points that become one there are one here.
        placed = (middle + size * fewer).astype(np.float32).astype(np.float64)
        made = mend(placed, chosen.astype(np.int64))
        if len(made[1]):
            return made
        count *= 2
    return points, faces


def _manifold(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface without faces of no use or at edges of more than two, consistently wound where it
    can be."""
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    change = drop(points, faces)
    points, faces = points[change.vertex_map], change.faces.astype(np.int64)
    return points, turn_faces(faces, len(points)).faces.astype(np.int64)
