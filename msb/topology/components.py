"""Connected components of a graph given as pairs of nodes. No other module joins elements into groups."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def label_components(count: int, first: NDArray[Any], second: NDArray[Any]) -> tuple[int, NDArray[np.int32]]:
    """Group `count` nodes so that both nodes of every pair are in the same group.

    Return the number of groups and the group (count,) of each node. Groups are numbered by their lowest node.
    Takes O(count + n) time and memory for n pairs.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(first) == 0:
        return count, np.arange(count, dtype=np.int32)
    # SciPy adds up repeated pairs. A float32 sum cannot overflow to zero, as an integer sum can.
    values = np.ones(len(first), np.float32)
    graph = coo_array((values, (first, second)), shape=(count, count)).tocsr()
    groups, labels = connected_components(graph, directed=False)
    return int(groups), labels
