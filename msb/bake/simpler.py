"""A surface of fewer faces, by quadric error, that is as closed, manifold and oriented as it was."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb.topology import audit_arrays
from msb.topology.analysis import Analysis
from msb.topology.halfedge import face_of
from msb.topology.seams import is_closed
from msb.topology.steps import close, drop, orient
from msb.topology.steps.change import with_faces

if TYPE_CHECKING:
    Reals = NDArray[np.float64]
    Faces = NDArray[np.int64]

_HASTE = 5
"""How fast the library raises the error that it allows: 7 unasked. Slower ends above the faces asked for."""


def closed(points: NDArray[Any], faces: Faces) -> bool:
    """Return whether a surface is closed, manifold and consistently wound."""
    return is_closed(audit_arrays(points, faces)[0].counts)


def simpler(points: Reals, faces: Faces, count: int) -> tuple[Reals, Faces]:
    """Return a surface of about `count` faces, no more than it has.

    A closed one stays closed, manifold and consistently wound: where so few faces leave nothing of it, it
    keeps more. Of an open one, faces go that make edges of more than two.

    Raises
    ------
    UsageError
        EXTRA_MISSING: fast-simplification is not installed.
    """
    need_extra("trial", "fast_simplification", what="a surface of fewer faces")
    import fast_simplification

    was_closed = closed(points, faces)
    middle, size = points[faces].mean(axis=(0, 1)), float(np.ptp(points[faces], axis=(0, 1)).max()) or 1.0
    unit = (points - middle) / size  # the library takes what is very small for nothing
    while count < len(faces):
        fewer, chosen = fast_simplification.simplify(
            unit, faces.astype(np.int32), target_count=count, agg=_HASTE
        )
        # As float32 has it, which is what is written: two points that become one there are one here.
        placed = (middle + size * fewer).astype(np.float32).astype(np.float64)
        made = _mended(placed, chosen.astype(np.int64), was_closed)
        if len(made[1]):
            return made
        count *= 2
    return points, faces


def _mended(points: Reals, faces: Faces, to_close: bool) -> tuple[Reals, Faces]:
    """Return a manifold without faces of no use, consistently wound where it can be.

    If it is `to_close`, holes are closed, and parts that stay open are left out.
    """
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    change = drop(points, faces)
    points, faces = points[change.vertex_map], change.faces.astype(np.int64)
    if to_close:
        points, faces = _capped(points, faces)
    faces = orient(faces, len(points)).faces.astype(np.int64)
    kept = _solid(points, faces) if to_close else np.ones(len(faces), bool)
    change = with_faces(faces, kept, len(points))
    return points[change.vertex_map], change.faces.astype(np.int64)


def _capped(points: Reals, faces: Faces) -> tuple[Reals, Faces]:
    """Return the surface with its holes closed."""
    change = close(points, faces, most_edges=len(faces), most_share=1.0)
    placed = points[change.vertex_map]
    if count := change.rims.count:
        sums = np.add.reduceat(points[change.rims.vertices], change.rims.offsets[:-1])
        placed[-count:] = sums / np.diff(change.rims.offsets)[:, None]
    return placed, change.faces.astype(np.int64)


def _solid(points: Reals, faces: Faces) -> NDArray[np.bool_]:
    """Return which faces (F,) are of parts that are closed, consistently wound, and no face and its back."""
    analysis = Analysis(points, faces)
    mesh, part = analysis.mesh, analysis.components.face_component
    edges = np.concatenate([analysis.boundary.edges, analysis.inconsistent_winding_edges])
    faulty = face_of(mesh.edge_halfedges[mesh.edge_offsets[edges]])
    found: NDArray[np.bool_] = ~np.isin(part, np.concatenate([part[faulty], part[analysis.duplicate]]))
    return found
