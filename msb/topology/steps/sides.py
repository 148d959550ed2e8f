"""The two sides of a surface. This module finds faces with the opposite winding, and one-sided components."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.halfedge import HalfEdgeMesh, face_of


@dataclass(frozen=True)
class Sides:
    """An assignment of graph nodes to two sides. For each pair of nodes, the two nodes must be on equal sides
    or on opposite sides.

    Attributes
    ----------
    label : (n,) integers
        The connected component of each node.
    other : (n,) bool
        Whether the node and the first node of its component are on different sides.
    one_sided : (n,) bool
        Whether the pairs of the component contradict each other.
    """

    label: NDArray[Any]
    other: NDArray[np.bool_]
    one_sided: NDArray[np.bool_]


def find_sides_of_faces(mesh: HalfEdgeMesh) -> Sides:
    """Find the faces with the opposite winding in each component. Components are joined across two-face
    edges."""
    first, second = mesh.two_face_halfedges
    clash = mesh.origin[first] == mesh.origin[second]
    return find_sides(mesh.face_count, face_of(first), face_of(second), clash)


def find_sides(count: int, first: NDArray[Any], second: NDArray[Any], differ: NDArray[np.bool_]) -> Sides:
    """Return the sides of `count` nodes.

    The input consists of pairs of nodes (n,). Each pair of nodes must be on opposite sides if `differ` is
    true, otherwise on equal sides. The double cover of the graph has two copies of each node, one per side. A
    component is two-sided if its cover has two parts. In a one-sided component, some pairs cannot be
    satisfied. All pairs with equal sides are satisfied. Among the pairs with opposite sides, only the pairs
    of a spanning tree are satisfied. The function takes O(n log n) time, or O(n) without one-sided
    components.
    """
    # Nodes that must be on equal sides become one node.
    nodes, part = label_components(count, first[~differ], second[~differ])
    sides = _find_sides_of_parts(nodes, part[first[differ]], part[second[differ]])
    return Sides(sides.label[part], sides.other[part], sides.one_sided[part])


def _find_sides_of_parts(count: int, first: NDArray[Any], second: NDArray[Any]) -> Sides:
    """Assign each of `count` nodes to one of two sides. The nodes of every pair must be on opposite sides."""
    labels = _label_double_cover(count, first, second)
    one_sided = labels[:count] == labels[count:]
    if one_sided.any():
        # In one-sided components, use only the pairs of a spanning tree. In all other components, use all
        # pairs.
        inside = np.flatnonzero(one_sided[first])
        inside = inside[first[inside] != second[inside]]
        tree = inside[find_spanning_tree(count, first[inside], second[inside], np.ones(len(inside)))]
        used = np.concatenate([tree, np.flatnonzero(~one_sided[first])])
        labels = _label_double_cover(count, first[used], second[used])
    return Sides(np.minimum(labels[:count], labels[count:]), labels[:count] > labels[count:], one_sided)


def find_spanning_tree(
    count: int, first: NDArray[Any], second: NDArray[Any], cost: NDArray[np.float64]
) -> NDArray[Any]:
    """Return the indices of the pairs in a minimum spanning forest.

    The two ends of each pair differ, and all `cost` (n,) are positive.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((cost, high, low))
    is_new = np.ones(len(order), bool)
    is_new[1:] = (low[order][1:] != low[order][:-1]) | (high[order][1:] != high[order][:-1])
    best = order[is_new]  # Keep only the cheapest pair between two nodes.
    # Replace costs by ranks, so that equal costs are ordered by their nodes.
    rank = np.zeros(len(best))
    rank[np.argsort(cost[best], kind="stable")] = np.arange(1, len(best) + 1)
    tree = minimum_spanning_tree(csr_array((rank, (low[best], high[best])), shape=(count, count)))
    by_rank = np.zeros(len(best) + 1, np.intp)
    by_rank[rank.astype(np.intp)] = best
    return np.asarray(by_rank[tree.data.astype(np.intp)])


def _label_double_cover(count: int, ends: NDArray[Any], other_ends: NDArray[Any]) -> NDArray[np.int32]:
    """Return the component labels (2 count,) of the double cover. The nodes on side 1 come first, then the
    nodes on side 2.

    Pairs connect opposite sides.
    """
    first, second = np.concatenate([ends, ends + count]), np.concatenate([other_ends + count, other_ends])
    return label_components(2 * count, first, second)[1]
