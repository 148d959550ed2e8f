"""Colour values of mesh files -> uint8, or float32 in [0, 1]."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def stored_colors(values: NDArray[Any]) -> NDArray[Any]:
    """Return colours (N, 3) or (N, 4) of any number type as uint8 or float32, in the machine's byte order.

    uint8 stays as it is. uint16 is divided by 65535. Other integers mean 0..255 and are clamped to that.
    Floats mean [0, 1] and are clamped to that, as glTF prescribes, unless they are the 0..255 some programs
    write: whole numbers, at least one above 1 and none above 255. NaN becomes 0.
    """
    if values.dtype.kind == "f":
        values = np.nan_to_num(values, nan=0.0)
        bytes_as_floats = (values == np.floor(values)).all() and (values >= 0).all()
        if values.size and bytes_as_floats and 1 < values.max() <= 255:
            return values.astype(np.uint8)
        values = np.clip(values, 0, 1)
    elif values.dtype == np.uint16:
        values = values / 65535
    else:
        return values.clip(0, 255).astype(np.uint8)
    return values.astype(np.float32)


def with_alpha(colors: NDArray[Any]) -> NDArray[Any]:
    """Return colours (N, 3 | 4) as (N, 4); what had no alpha is opaque."""
    if colors.shape[1] == 4:
        return colors
    opaque = 255 if colors.dtype == np.uint8 else 1
    alpha = np.full((len(colors), 1), opaque, dtype=colors.dtype)
    return np.concatenate((colors, alpha), axis=1)
