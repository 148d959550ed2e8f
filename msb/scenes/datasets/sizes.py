"""The size at which each loader evaluates a photograph of a given size.

A `resolution` is what the 3DGS family takes as ``-r``: 1, 2, 4 or 8 divide the size, -1 leaves all but very
large photographs alone, any other number is a width in pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from msb.errors import SceneError, shorten
from msb.scenes.checks import MAX_SIDE

Size = tuple[int, int]
Rounding = Literal["half_even", "floor", "half_up"]

AS_IS = -1
LARGEST = 1600
"""Size in pixels to which larger photographs are reduced if no resolution is asked for."""
_DIVISORS = (1, 2, 4, 8)


def check_resolution(resolution: int) -> int:
    """Return `resolution` if it is a valid one."""
    whole = isinstance(resolution, int) and not isinstance(resolution, bool)
    if not whole or not (resolution == AS_IS or 1 <= resolution <= MAX_SIDE):
        text = (
            f"the resolution is {shorten(repr(resolution), 40)}; it must be 1, 2, 4 or 8, which divide, "
            "-1, as is, or a width in pixels"
        )
        raise SceneError("SCENE_ARGUMENT", text)
    return resolution


def half_even(size: Size, resolution: int) -> Size:
    """Return the size the 3DGS family, Triangle-Splatting, MeshSplatting and 2DGS resize to.

    Divided sides are rounded half to even, others cut off. Only a width above `LARGEST` is reduced at -1.

    Source: `graphdeco-inria/gaussian-splatting`: utils/camera_utils.py (`loadCam`).
    """
    width, height = size
    if resolution in _DIVISORS:
        return round(width / resolution), round(height / resolution)
    if resolution == AS_IS and width <= LARGEST:
        return size
    scale = width / (LARGEST if resolution == AS_IS else resolution)
    return int(width / scale), int(height / scale)  # 1601 / (1601 / 1600) is a little less than 1600


def floor(size: Size, resolution: int) -> Size:
    """Return the size 2DTS resizes to: sides cut off; at -1 the longer side is at most `LARGEST`.

    Source: `GaodeRender/triangle-splatting`: the datasets' `target_res`. It has no widths; the family's rule
    stands in for them.
    """
    width, height = size
    if resolution in _DIVISORS:
        return width // resolution, height // resolution
    if resolution != AS_IS:
        return half_even(size, resolution)
    longest = max(size)
    if longest <= LARGEST:
        return size
    return width * LARGEST // longest, height * LARGEST // longest


def half_up(size: Size, resolution: int) -> Size:
    """Return the size of the folders images_2, images_4 and images_8 as Mip-NeRF 360 ships them.

    Divided sides are rounded half up (`nerfbaselines/nerfbaselines`: its Mip-NeRF 360 loader); otherwise
    as `half_even`.
    """
    if resolution not in _DIVISORS:
        return half_even(size, resolution)
    width, height = (math.floor(side / resolution + 0.5) for side in size)
    return width, height


ROUNDINGS: dict[Rounding, Callable[[Size, int], Size]] = {
    "half_even": half_even,
    "floor": floor,
    "half_up": half_up,
}
