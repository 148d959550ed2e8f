"""Which faces of a blended model to keep when all of them become opaque, in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Owned = Callable[[NDArray[np.bool_]], NDArray[np.float64]]
"""From which faces are kept, (F,) bool, to the pixels that each owns over all views, (F,); others own 0."""


def chosen(owned: Owned, weight: NDArray[np.float64], threshold: float, rounds: int = 6) -> NDArray[np.bool_]:
    """Return which faces to keep, (F,) bool: those that add to the pictures what their pixels ask for.

    As an opaque face a faint one hides all behind it. A face goes if its `weight` in the teacher's pictures,
    (F,) pixels, is below `threshold` times the pixels that it owns as an opaque one. The worst go first,
    because what they hide may deserve to be seen: in round k of `rounds` the limit is k / rounds of the
    threshold, and pixels are counted anew. A face that owns nothing stays, such as one that no view sees.
    """
    keep = np.ones(len(weight), np.bool_)
    for k in range(1, rounds + 1):
        keep = keep & (weight >= threshold * k / rounds * owned(keep))
    return keep
