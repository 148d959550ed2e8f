"""Make the winding consistent across two-face edges. In each component, turn as few faces as possible."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import build_half_edges
from msb.topology.steps.change import Change, followed_by
from msb.topology.steps.one_sided import cut_one_sided
from msb.topology.steps.sides import find_sides_of_faces


def orient(faces: NDArray[Any], vertex_count: int, *, only_turn: bool = False) -> Change:
    """Turn faces so that the two faces of every two-face edge traverse the edge in opposite directions.

    Components are joined across two-face edges. In each component, the minority of faces is turned. If
    exactly half of the faces would be turned, the first face keeps its winding. A one-sided component, such
    as a Moebius strip, is cut first. The cut copies vertices. A note gives the number of cuts and cut edges.
    If `only_turn` is true, a mesh with edges of more than two faces is not cut. A cut would separate all
    faces at such edges. The step takes O(F log F) time without one-sided components.
    """
    change, cuts, edges = cut_one_sided(faces, vertex_count, only_manifold=only_turn)
    turned = turn_faces(change.faces, len(change.vertex_map))
    if not cuts:
        return turned
    times = "once" if cuts == 1 else f"{cuts:,} times"
    along = f"along {edges:,} edge{'' if edges == 1 else 's'}"
    note = f"one-sided surfaces (Moebius strips) are cut {times}, {along}, to make the winding consistent"
    return followed_by(replace(change, notes=(note,)), turned)


def turn_faces(faces: NDArray[Any], vertex_count: int) -> Change:
    """Turn faces like `orient`, but without cutting. Some edges of a one-sided surface stay inconsistent.

    Edges that are already consistent are preferred. A second run therefore turns no face.
    """
    sides = find_sides_of_faces(build_half_edges(faces, vertex_count))
    # The majority of each component keeps its winding.
    count = int(sides.label.max(initial=-1)) + 1
    others = np.bincount(sides.label[sides.other], minlength=count)
    turned = sides.other ^ (2 * others > np.bincount(sides.label, minlength=count))[sides.label]
    new = np.where(turned[:, None], faces[:, (0, 2, 1)], faces)
    return Change(new, np.arange(vertex_count), np.arange(len(faces)), turned)
