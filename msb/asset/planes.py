"""Check the near and far planes of DiffSoup against the precision of the camera matrix."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.matrices import inverse
from msb.errors import UsageError


def invert_projection(mvp: NDArray[Any], near: float, far: float) -> NDArray[Any]:
    """Return the inverse of the model-view-projection matrix (4, 4). The inverse is computed in float64 and
    then rounded.

    The view direction of a pixel is the line between two points. The two points lie on the near plane and the
    far plane, at NDC depth -1 and 1. The inverse matrix must give w > 0 for the near point and the far point
    of every pixel. A far plane that rounds to infinity has w = 0.

    Raises
    ------
    UsageError
        SETTING_VALUE: the dtype of `mvp` cannot represent the planes.
    """
    if near < far:
        with np.errstate(all="ignore"):
            back: NDArray[Any] = inverse(mvp.astype(np.float64)).astype(mvp.dtype)
        if np.isfinite(back).all():
            # The homogeneous coordinate is w = across x + down y + along z + constant, with x, y and z in
            # [-1, 1].
            across, down, along, constant = back[3]
            if constant - abs(along) - abs(across) - abs(down) > 0:
                return back
    text = f"the settings z_near {near:g} and z_far {far:g} are invalid: z_near must be below z_far, and "
    text += f"{mvp.dtype} must be able to represent their ratio: z_far / z_near must be below about "
    text += f"{1 / np.finfo(mvp.dtype).eps:.0e}"
    raise UsageError("SETTING_VALUE", text)
