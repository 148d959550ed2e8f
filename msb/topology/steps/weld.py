"""Merge coincident vertices, as a step of a repair."""

from typing import Any

from numpy.typing import NDArray

from msb.topology.faces import names_vertex_twice
from msb.topology.steps.change import Change, followed_by, with_faces, with_vertices
from msb.topology.weld import Weld, merged_vertices


def weld(points: NDArray[Any], faces: NDArray[Any], distance: Weld = "exact") -> Change:
    """Merge vertices in one place, as the audit's weld does, and remove the faces that collapse by it.

    Each set of merged vertices is its first one, with that one's values.
    """
    kept, number = merged_vertices(points, distance)
    new = number.astype(faces.dtype)[faces]
    collapsed = names_vertex_twice(new) & ~names_vertex_twice(faces)
    return followed_by(with_vertices(new, kept), with_faces(new, ~collapsed, len(kept)))
