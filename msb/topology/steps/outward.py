"""Turn closed bodies that are wound inside out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import build_half_edges
from msb.topology.solids import find_inside_out, label_bodies
from msb.topology.steps.change import Change


def outward(points: NDArray[Any], faces: NDArray[Any]) -> Change:
    """Turn all faces of closed, manifold and consistently wound bodies whose volume is negative.

    Cavities inside a larger body, open pieces and pieces with inconsistent winding stay as they are.
    """
    mesh = build_half_edges(faces, len(points))
    label = label_bodies(faces, len(points))
    # Exclude a body if some edge does not have exactly two faces in opposite directions.
    first, second = mesh.two_face_halfedges
    good = np.zeros(mesh.edge_count, bool)
    good[np.flatnonzero(mesh.multiplicity == 2)] = mesh.origin[first] != mesh.origin[second]
    bad = (~good[mesh.edge]).reshape(-1, 3).any(axis=1) | mesh.repeated_index
    turns, _ = find_inside_out(points, faces, label)
    turns[label[bad]] = False
    turned = turns[label] if len(label) else np.zeros(0, bool)
    new = np.where(turned[:, None], faces[:, (0, 2, 1)], faces)
    return Change(new, np.arange(len(points)), np.arange(len(faces)), turned)
