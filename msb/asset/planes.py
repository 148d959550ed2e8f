"""Which near and far planes of DiffSoup the camera's matrix can hold in floating point."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.matrices import inverse
from msb.errors import UsageError


def invert_projection(mvp: NDArray[Any], near: float, far: float) -> NDArray[Any]:
    """Return the inverse of MVP (4, 4), for column vectors, taken in double and rounded to its dtype.

    A view direction is the line between the points where a pixel meets the two planes, whose camera depths
    `near` and `far` become NDC -1 and 1. The inverse must give both points with w above 0 at all pixels: a
    far plane that rounds to infinity has w = 0, which gives no point.
    """
    if near < far:
        with np.errstate(all="ignore"):
            back: NDArray[Any] = inverse(mvp.astype(np.float64)).astype(mvp.dtype)
        if np.isfinite(back).all():
            across, down, along, constant = back[3]
            if constant - abs(along) - abs(across) - abs(down) > 0:
                return back
    text = f"settings z_near {near:g} and z_far {far:g} are no range of depths: z_near must be below z_far, "
    text += f"and {mvp.dtype} must tell them from 0 and infinity: z_far / z_near must be below about "
    text += f"{1 / np.finfo(mvp.dtype).eps:.0e}"
    raise UsageError("SETTING_VALUE", text)
