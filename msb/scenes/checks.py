"""Validation of each value of a camera. Each function raises CAMERA_INVALID with a clear message."""

import math
import operator
import re
import unicodedata
from collections.abc import Sequence
from typing import Literal, get_args

from msb.errors import SceneError, shorten

Split = Literal["train", "val", "test"]
SPLITS: tuple[str, ...] = get_args(Split)

# Largest width and height in pixels, which is the limit of JPEG. Graphics cards have lower limits.
MAX_SIDE = 65535
# Largest number of pixels of an image, which take 3 GiB as float32 RGB.
MAX_PIXELS = 1 << 28
# Smallest and largest focal length in pixels. Outside this range, the field of view in float32 is 0 or 180
# degrees.
MIN_FOCAL, MAX_FOCAL = 1e-9, 1e9
# Longest name of a camera, in characters.
MAX_NAME = 1024


def check_size(size: Sequence[int]) -> tuple[int, int]:
    """Return `size` as integers (width, height) if it is a valid image size."""
    if len(size) != 2:
        raise SceneError("CAMERA_INVALID", f"the size is {_abbreviated(size)}; it must be width and height")
    width, height = _side("width", size[0]), _side("height", size[1])
    if width * height > MAX_PIXELS:
        text = f"{width} x {height} are {width * height} pixels; at most {MAX_PIXELS} are allowed"
        raise SceneError("CAMERA_INVALID", text)
    return width, height


def _side(what: str, value: int) -> int:
    try:
        side = operator.index(value)
    except TypeError:
        side = 0
    if not 1 <= side <= MAX_SIDE:
        text = f"{what} is {_abbreviated(value)}; it must be a whole number of pixels from 1 to {MAX_SIDE}"
        raise SceneError("CAMERA_INVALID", text)
    return side


def check_pixels(what: str, value: float, least: float = -MAX_FOCAL) -> float:
    """Return `value` as a float if it is a valid coordinate of the principal point in pixels.

    For a focal length, pass `MIN_FOCAL` as `least`.
    """
    if not least <= value <= MAX_FOCAL:
        text = (
            f"{what} is {_abbreviated(value)}; it must be a number of pixels from {least:g} to {MAX_FOCAL:g}"
        )
        raise SceneError("CAMERA_INVALID", text)
    return float(value)


def focal_from_fov(angle: float | None, side: int, what: str) -> float:
    """Return the focal length in pixels of an image of `side` pixels with the full `angle` in radians."""
    if angle is None or not 0 < angle < math.pi:
        text = f"{what} is {_abbreviated(angle)}; it must be an angle in radians between 0 and pi"
        raise SceneError("CAMERA_INVALID", text)
    return side / (2 * math.tan(angle / 2))


def check_name(name: str) -> None:
    """Check that `name` is a valid relative file name on every system.

    Camera names from files become names of output files. Therefore a name must not point outside a folder.
    """
    if not 0 < len(name) <= MAX_NAME:
        text = f"the name is {_abbreviated(name)}; it must be text of 1 to {MAX_NAME} characters"
    elif any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name):
        text = f"the name {_abbreviated(name)} contains a control character or half of a surrogate pair"
    elif "\\" in name or name.startswith("/") or re.match("[A-Za-z]:", name):
        text = (
            f"the name {_abbreviated(name)} is absolute or contains a backslash; use a relative path with '/'"
        )
    elif any(part in ("", ".", "..") for part in name.split("/")):
        text = f"the name {_abbreviated(name)} has an empty part, '.' or '..'; remove these parts"
    else:
        return
    raise SceneError("CAMERA_INVALID", text)


def _abbreviated(value: object) -> str:
    return shorten(repr(value), 60)
