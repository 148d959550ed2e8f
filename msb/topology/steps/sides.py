"""On which side of a surface its faces are wound, and what is one-sided."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.halfedge import HalfEdgeMesh, face_of


@dataclass(frozen=True)
class Sides:
    """Which nodes of a graph lie on the same side, if every pair says "same side" or "other side".

    `label` (n,) is the connected component of each node, `other` (n,) whether it is on the other side than
    the first node of that, `one_sided` (n,) whether no choice of sides fits all its pairs.
    """

    label: NDArray[Any]
    other: NDArray[np.bool_]
    one_sided: NDArray[np.bool_]


def sides_of_faces(mesh: HalfEdgeMesh) -> Sides:
    """Return which faces of each component, joined across ordinary edges, are wound the other way."""
    one, other = mesh.two_face_halfedges
    clash = mesh.origin[one] == mesh.origin[other]
    return find_sides(mesh.face_count, face_of(one), face_of(other), clash)


def find_sides(count: int, one: NDArray[Any], other: NDArray[Any], differ: NDArray[np.bool_]) -> Sides:
    """Return the sides of `count` nodes from pairs whose ends must lie on the same side, or must `differ`.

    Each node stands for two, itself on either side, and pairs join these (the double cover). A component that
    falls into two halves has its sides; one that does not is one-sided, and there the pairs of a spanning
    tree decide, after those that agree. O(n log n) time, O(n) where nothing is one-sided.
    """
    # What must agree is one node.
    nodes, part = label_components(count, one[~differ], other[~differ])
    parts = _sides_of_parts(nodes, part[one[differ]], part[other[differ]])
    return Sides(parts.label[part], parts.other[part], parts.one_sided[part])


def _sides_of_parts(count: int, one: NDArray[Any], other: NDArray[Any]) -> Sides:
    """Return the sides of nodes from pairs whose ends must lie on different sides."""
    labels = _double_cover(count, one, other)
    one_sided = labels[:count] == labels[count:]
    if one_sided.any():
        inside = np.flatnonzero(one_sided[one])
        inside = inside[one[inside] != other[inside]]
        tree = inside[spanning_tree(count, one[inside], other[inside], np.ones(len(inside)))]
        used = np.concatenate([tree, np.flatnonzero(~one_sided[one])])
        labels = _double_cover(count, one[used], other[used])
    return Sides(np.minimum(labels[:count], labels[count:]), labels[:count] > labels[count:], one_sided)


def spanning_tree(
    count: int, one: NDArray[Any], other: NDArray[Any], cost: NDArray[np.float64]
) -> NDArray[Any]:
    """Return the numbers of the pairs of a spanning forest of least cost; ends differ, costs are positive."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    low, high = np.minimum(one, other), np.maximum(one, other)
    order = np.lexsort((cost, high, low))
    first = np.ones(len(order), bool)
    first[1:] = (low[order][1:] != low[order][:-1]) | (high[order][1:] != high[order][:-1])
    best = order[first]  # of pairs between the same two nodes the cheapest
    # Values are ranks, so that equal costs are decided by the order of the nodes and never by chance.
    rank = np.zeros(len(best))
    rank[np.argsort(cost[best], kind="stable")] = np.arange(1, len(best) + 1)
    tree = minimum_spanning_tree(csr_array((rank, (low[best], high[best])), shape=(count, count)))
    by_rank = np.zeros(len(best) + 1, np.intp)
    by_rank[rank.astype(np.intp)] = best
    return np.asarray(by_rank[tree.data.astype(np.intp)])


def _double_cover(count: int, one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.int32]:
    """Return the labels of the nodes on this side, then on the other; the ends of a pair are on different."""
    first, second = np.concatenate([one, one + count]), np.concatenate([other + count, other])
    return label_components(2 * count, first, second)[1]
