"""Seam keys: hashes of vertex attributes that msb does not read.

Two vertices with equal positions may differ in these attributes only.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Names of attributes in `msb.topology.seams.Attributes`. SEAM_KEY is also the name of a buffer of an asset.
SEAM_KEY, TRIANGLE_LIST = "seam_key", "triangle_list"
# Multiplier of the Fibonacci hash: 2^32 divided by the golden ratio.
_MULTIPLIER = np.uint32(0x9E3779B1)


def hash_attributes(columns: Iterable[NDArray[Any]]) -> NDArray[np.uint32]:
    """Return the seam keys (n,) of n vertices.

    A seam key is a hash of one row of all attribute arrays (n, k).

    Rows with equal values have equal hashes. Different rows have equal hashes with a probability of 2^-32.
    """
    key: NDArray[np.uint32] = np.zeros(0, np.uint32)
    for values in columns:
        rows = np.ascontiguousarray(values).reshape(len(values), -1)
        if rows.dtype.kind == "f":
            rows = rows + rows.dtype.type(0)  # -0 becomes +0
        # words (n, m) uint32: the bits of each row. Smaller integers are widened to 32 bits.
        wide: NDArray[Any] = rows.astype(np.int64 if rows.dtype.kind in "iub" else np.float64)
        words: NDArray[np.uint32] = wide.view(np.uint32)
        key = key if len(key) else np.full(len(words), 0x811C9DC5, np.uint32)
        for column in words.T:
            key = (key ^ column) * _MULTIPLIER
            key ^= key >> np.uint32(15)
    return key
