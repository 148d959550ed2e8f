"""Connected components of a graph given as pairs of nodes. Only this module joins elements into groups."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def label_components(count: int, first: NDArray[Any], second: NDArray[Any]) -> tuple[int, NDArray[np.int32]]:
    """Assign `count` nodes to groups so that both nodes of every pair are in one group.

    Return the number of groups, and the group (count,) of each node. Groups are numbered by their lowest
    node. Takes O(count + n) time and memory for n pairs.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(first) == 0:
        return count, np.arange(count, dtype=np.int32)
    # SciPy adds up the values of repeated pairs, and the sum must not become 0. An integer sum could overflow
    # to 0, but a float32 sum cannot.
    values = np.ones(len(first), np.float32)
    graph = coo_array((values, (first, second)), shape=(count, count)).tocsr()
    groups, labels = connected_components(graph, directed=False)
    return int(groups), labels
