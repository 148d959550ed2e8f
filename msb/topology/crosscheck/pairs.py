"""A mesh counted the way most peers count: every row has three vertex pairs, repeated indices or not."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.halfedge import next_in_face


def pair_numbers(faces: NDArray[Any]) -> dict[str, int]:
    """Return counts over the unordered vertex pairs of all rows, loops {v, v} included.

    On rows without a repeated index the numbers are those of our own definitions: `pairs`; `single`, `double`
    and `crowded` pairs with one, two and more members, `most` members; `crowded_by_rows`, the crowded ones
    that more than one row has; `igl_edges`, see below; `endpoints` of crowded pairs, `multifan` and `strict`
    vertices, vertices `used` and `unused` (its negative); `components`, the `largest` of them,
    `two_face_components`; `inconsistent` double pairs; `double_loops`, of which proper rows have
    none; `double_fans`, the vertices whose rows are in several groups if double pairs alone join them.
    """
    start = faces.reshape(-1).astype(np.uint64)
    end = faces[:, (1, 2, 0)].reshape(-1).astype(np.uint64)
    low, high = np.minimum(start, end), np.maximum(start, end)
    span = start.max(initial=np.uint64(0)) + np.uint64(1)
    pair, member, count = np.unique(low * span + high, return_inverse=True, return_counts=True)
    order = np.argsort(member, kind="stable")
    linked = member[order][1:] == member[order][:-1]
    one, other = order[:-1][linked], order[1:][linked]  # two half-edges of a pair, next to each other
    loop = pair // span == pair % span
    double = count[member[one]] == 2
    components, component = label_components(len(faces), one // 3, other // 3)
    two_face, _ = label_components(len(faces), one[double] // 3, other[double] // 3)
    crowded = np.flatnonzero(count > 2)
    endpoints = np.unique(np.stack([pair[crowded] // span, pair[crowded] % span]))
    multifan = _multifan(start, end, span, one, other)
    used = len(np.unique(start))
    between_rows = np.unique(member[one[one // 3 != other // 3]])
    return {
        "pairs": len(pair),
        # igl.edges halves the entries of the symmetric adjacency matrix, where a loop is one entry.
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
        "double_fans": len(_multifan(start, end, span, one[double], other[double])),
        "inconsistent": int(np.count_nonzero(end[one[double]] != start[other[double]])),
    }


def _multifan(
    start: NDArray[np.uint64],
    end: NDArray[np.uint64],
    span: np.uint64,
    one: NDArray[Any],
    other: NDArray[Any],
) -> NDArray[np.uint64]:
    """Return the vertices whose rows, joined through shared pairs there, are in several groups."""
    halfedge = np.arange(len(start))
    row = (halfedge // 3).astype(np.uint64)
    place, node = np.unique(row * span + start, return_inverse=True)  # a row is at a vertex once
    after = node[next_in_face(halfedge)]
    at_low, at_high = np.where(start <= end, node, after), np.where(start <= end, after, node)
    groups, group = label_components(
        len(place),
        np.concatenate([at_low[one], at_high[one]]),
        np.concatenate([at_low[other], at_high[other]]),
    )
    vertex_of_group = np.zeros(groups, np.uint64)
    vertex_of_group[group] = place % span
    vertex, times = np.unique(vertex_of_group, return_counts=True)
    return vertex[times > 1]
