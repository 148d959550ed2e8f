"""The definition of a triangle soup: triangles that share no vertices."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_soup(faces: NDArray[Any]) -> bool:
    """Return whether faces (F, 3) are a triangle soup, in which no two faces use the same vertex.

    A face that lists a vertex twice is one use of this vertex.
    """
    # Count the faces that use each vertex, (V,).
    a, b, c = faces.T
    uses = np.bincount(np.concatenate([a, b[b != a], c[(c != a) & (c != b)]]))
    return bool(uses.max(initial=0) < 2)


def is_unindexed(faces: NDArray[Any], vertex_count: int) -> bool:
    """Return whether each vertex is used by exactly one face corner.

    A mesh with this property is a triangle soup without unused vertices and without faces that list a vertex
    twice.
    """
    corners = faces.reshape(-1)
    return len(corners) == vertex_count and bool((np.bincount(corners) == 1).all())
