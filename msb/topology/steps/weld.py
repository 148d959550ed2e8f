"""Merge coincident vertices as a step of a repair."""

from typing import Any

from numpy.typing import NDArray

from msb.topology.faces import names_vertex_twice
from msb.topology.steps.change import Change, followed_by, with_faces, with_vertices
from msb.topology.weld import Weld, merge_coincident


def weld(points: NDArray[Any], faces: NDArray[Any], distance: Weld = "exact") -> Change:
    """Merge coincident vertices like the weld of the audit, and remove the faces that collapse.

    In each set of merged vertices, the first vertex stays, with its attribute values.
    """
    kept, number = merge_coincident(points, distance)
    new = number.astype(faces.dtype)[faces]
    collapsed = names_vertex_twice(new) & ~names_vertex_twice(faces)
    return followed_by(with_vertices(new, kept), with_faces(new, ~collapsed, len(kept)))
