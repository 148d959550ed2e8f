"""Connected components of a graph given by pairs. Only this module joins elements into groups."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def label_components(count: int, first: NDArray[Any], second: NDArray[Any]) -> tuple[int, NDArray[np.int32]]:
    """Group `count` nodes so that the two ends of every pair are in one group.

    Return how many groups there are and the group (count,) of each node, numbered by their smallest node.
    O(count + n) time and memory.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(first) == 0:
        return count, np.arange(count, dtype=np.int32)
    # Pairs may repeat: values would be summed, so they are wide enough never to cancel or wrap to zero.
    values = np.ones(len(first), np.float32)
    graph = coo_array((values, (first, second)), shape=(count, count)).tocsr()
    groups, labels = connected_components(graph, directed=False)
    return int(groups), labels
