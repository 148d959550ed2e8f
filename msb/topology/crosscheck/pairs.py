"""Counts of vertex pairs as most peers define them.

Such peers count three vertex pairs for a face with a repeated index, like for other faces.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.halfedge import next_in_face


def count_pairs(faces: NDArray[Any]) -> dict[str, int]:
    """Return counts over the unordered vertex pairs of all rows of `faces` (F, 3), including loops {v, v}.

    Without repeated-index faces, these counts equal the counts of our audit. The keys are:

    - `pairs`: the number of pairs.
    - `single`, `double` and `crowded`: pairs with one, two and more members.
    - `most`: the largest number of members of a pair.
    - `crowded_by_rows`: crowded pairs that several faces share.
    - `igl_edges`: the count of igl.edges.
    - `endpoints`: the vertices of crowded pairs.
    - `multifan` and `strict`: non-manifold vertices by two definitions.
    - `used` and `unused`: used vertices, and the negative number of unused vertices.
    - `components`, `largest` and `two_face_components`: components, faces of the largest component, and
      components across two-face edges.
    - `inconsistent`: double pairs with inconsistent winding.
    - `double_loops`: double pairs {v, v}.
    - `double_fans`: vertices with several groups of faces if only double pairs join faces.
    """
    start = faces.reshape(-1).astype(np.uint64)
    end = faces[:, (1, 2, 0)].reshape(-1).astype(np.uint64)
    low, high = np.minimum(start, end), np.maximum(start, end)
    span = start.max(initial=np.uint64(0)) + np.uint64(1)
    pair, member, count = np.unique(low * span + high, return_inverse=True, return_counts=True)
    # The half-edges `first` and `second` are consecutive members of a pair in sorted order.
    order = np.argsort(member, kind="stable")
    linked = member[order][1:] == member[order][:-1]
    first, second = order[:-1][linked], order[1:][linked]
    loop = pair // span == pair % span
    double = count[member[first]] == 2
    components, component = label_components(len(faces), first // 3, second // 3)
    two_face, _ = label_components(len(faces), first[double] // 3, second[double] // 3)
    crowded = np.flatnonzero(count > 2)
    endpoints = np.unique(np.stack([pair[crowded] // span, pair[crowded] % span]))
    multifan = _find_multifan(start, end, span, first, second)
    used = len(np.unique(start))
    between_rows = np.unique(member[first[first // 3 != second // 3]])
    return {
        "pairs": len(pair),
        # igl.edges counts half of the entries of the symmetric adjacency matrix. In the adjacency matrix, a
        # loop {v, v} has a single entry.
        "igl_edges": int(np.count_nonzero(~loop)) + int(np.count_nonzero(loop)) // 2,
        "single": int(np.count_nonzero(count == 1)),
        "double": int(np.count_nonzero(count == 2)),
        "crowded": len(crowded),
        "crowded_by_rows": len(np.intersect1d(crowded, between_rows)),
        "most": int(count.max(initial=0)),
        "endpoints": len(endpoints),
        "multifan": len(multifan),
        "strict": len(np.union1d(multifan, endpoints)),
        "used": used,
        "unused": -used,
        "components": components,
        "largest": int(np.bincount(component).max(initial=0)),
        "two_face_components": two_face,
        "double_loops": int(np.count_nonzero(loop & (count == 2))),
        "double_fans": len(_find_multifan(start, end, span, first[double], second[double])),
        "inconsistent": int(np.count_nonzero(end[first[double]] != start[second[double]])),
    }


def _find_multifan(
    start: NDArray[np.uint64],
    end: NDArray[np.uint64],
    span: np.uint64,
    first: NDArray[Any],
    second: NDArray[Any],
) -> NDArray[np.uint64]:
    """Join faces at the given half-edge pairs, and return the vertices at which the faces form several
    groups."""
    halfedge = np.arange(len(start))
    row = (halfedge // 3).astype(np.uint64)
    place, node = np.unique(row * span + start, return_inverse=True)
    after = node[next_in_face(halfedge)]
    at_low, at_high = np.where(start <= end, node, after), np.where(start <= end, after, node)
    groups, group = label_components(
        len(place),
        np.concatenate([at_low[first], at_high[first]]),
        np.concatenate([at_low[second], at_high[second]]),
    )
    vertex_of_group = np.zeros(groups, np.uint64)
    vertex_of_group[group] = place % span
    vertex, times = np.unique(vertex_of_group, return_counts=True)
    return vertex[times > 1]
