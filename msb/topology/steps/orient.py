"""Make the winding consistent across ordinary edges, turning as few faces as a component allows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import build_half_edges
from msb.topology.steps.change import Change, followed_by
from msb.topology.steps.one_sided import cut_one_sided
from msb.topology.steps.sides import sides_of_faces


def orient(faces: NDArray[Any], vertex_count: int, *, only_turn: bool = False) -> Change:
    """Turn faces so that the two faces of every ordinary edge run along it in opposite directions.

    Faces are joined across edges of exactly two faces. In each component the side of fewer faces is turned;
    of equal ones the first face stays. A one-sided component (a Moebius strip) is cut before, which copies
    vertices; a note says how often, and along how many edges. That parts edges of more than two faces, so a
    mesh that has some is not cut if `only_turn`. O(F log F) time where nothing is one-sided.
    """
    cut, cuts, edges = cut_one_sided(faces, vertex_count, only_manifold=only_turn)
    turned = turn_faces(cut.faces, len(cut.vertex_map))
    if not cuts:
        return turned
    times = "once" if cuts == 1 else f"{cuts:,} times"
    along = f"along {edges:,} edge{'' if edges == 1 else 's'}"
    note = f"what is one-sided, like a Moebius strip, is cut {times}, {along}, so that one winding fits"
    return followed_by(Change(cut.faces, cut.vertex_map, cut.face_map, cut.turned, notes=(note,)), turned)


def turn_faces(faces: NDArray[Any], vertex_count: int) -> Change:
    """Turn faces as `orient` does and cut nothing, so that on what is one-sided some edges still disagree.

    Those are kept few by preferring edges that agree already, so a second run turns nothing.
    """
    sides = sides_of_faces(build_half_edges(faces, vertex_count))
    # In each component all faces end on the side that had more of them.
    count = int(sides.label.max(initial=-1)) + 1
    others = np.bincount(sides.label[sides.other], minlength=count)
    turned = sides.other ^ (2 * others > np.bincount(sides.label, minlength=count))[sides.label]
    new = np.where(turned[:, None], faces[:, (0, 2, 1)], faces)
    return Change(new, np.arange(vertex_count), np.arange(len(faces)), turned)
