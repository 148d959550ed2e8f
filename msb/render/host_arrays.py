"""Host arrays into which frames are read. An array is used again once nobody holds it."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_OWN_REFERENCES = 4
"""References that an array has if nobody else holds it or a view of it: the pool's list, two names and the
argument of getrefcount."""
_KEPT = 8
"""Number of arrays kept: those of two frames, so that a caller may hold on to the last frame."""


class HostArrays:
    """Hands out arrays of undefined content.

    The first touch of new memory costs several times what copying a frame into it does (docs/opencl.md), so
    an array that was handed out before is handed out again, but only when its former owner has dropped it
    and every view of it.
    """

    def __init__(self) -> None:
        self._arrays: list[NDArray[Any]] = []

    def take(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array that nobody else holds."""
        wanted = shape, np.dtype(dtype)
        for array in self._arrays:
            if (array.shape, array.dtype) == wanted and _references(array) <= _OWN_REFERENCES:
                return array
        array = np.empty(*wanted)  # noqa: TID251 - filled by the reader
        self._arrays.append(array)
        del self._arrays[:-_KEPT]
        return array


def _references(array: NDArray[Any]) -> int:
    # Not every Python counts references; then nothing is used again.
    count = getattr(sys, "getrefcount", None)
    return count(array) if count else _OWN_REFERENCES + 1
