"""The definition of a triangle soup, which every part of msb shares."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_soup(faces: NDArray[Any]) -> bool:
    """Return whether faces (F, 3) are a triangle soup: no vertex is used by two of them.

    A face that names a vertex twice uses it once.
    """
    a, b, c = faces.T
    uses = np.bincount(np.concatenate([a, b[b != a], c[(c != a) & (c != b)]]))
    return bool(uses.max(initial=0) < 2)


def is_unindexed(faces: NDArray[Any], vertex_count: int) -> bool:
    """Return whether every vertex is one corner of one face, so that the indices only give an order.

    Such faces are a soup without unused vertices and without faces that name a vertex twice.
    """
    corners = faces.reshape(-1)
    return len(corners) == vertex_count and bool((np.bincount(corners) == 1).all())
