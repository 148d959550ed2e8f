"""Checks of the single values a camera is made of; each refuses with one clear error."""

import math
import operator
import re
import unicodedata
from collections.abc import Sequence
from typing import Literal, get_args

from msb.errors import SceneError, shorten

Split = Literal["train", "val", "test"]
SPLITS: tuple[str, ...] = get_args(Split)

# Most pixels along a side, which JPEG and textures of any graphics card can hold.
MAX_SIDE = 65535
# Most pixels of an image: as float32 RGB they take 3 GiB.
MAX_PIXELS = 1 << 28
# Least and greatest focal length in pixels; beyond them a float32 renderer has a field of view of 180 or 0
# degrees.
MIN_FOCAL, MAX_FOCAL = 1e-9, 1e9
MAX_NAME = 1024


def check_size(size: Sequence[int]) -> tuple[int, int]:
    """Return `size`, a pair, as integers (width, height) if an image can have that size."""
    if len(size) != 2:
        raise SceneError("CAMERA_INVALID", f"the size is {_shown(size)}; it must be width and height")
    width, height = _side("width", size[0]), _side("height", size[1])
    if width * height > MAX_PIXELS:
        text = f"{width} x {height} are {width * height} pixels; {MAX_PIXELS} are allowed"
        raise SceneError("CAMERA_INVALID", text)
    return width, height


def _side(what: str, value: int) -> int:
    try:
        side = operator.index(value)
    except TypeError:
        side = 0
    if not 1 <= side <= MAX_SIDE:
        text = f"{what} is {_shown(value)}; it must be a whole number of pixels from 1 to {MAX_SIDE}"
        raise SceneError("CAMERA_INVALID", text)
    return side


def check_pixels(what: str, value: float, least: float = -MAX_FOCAL) -> float:
    """Return `value` as a float if it can be a coordinate of the principal point in pixels.

    A focal length is at `least` `MIN_FOCAL`.
    """
    if not least <= value <= MAX_FOCAL:
        text = f"{what} is {_shown(value)}; it must be a number of pixels from {least:g} to {MAX_FOCAL:g}"
        raise SceneError("CAMERA_INVALID", text)
    return float(value)


def focal_from_fov(angle: float | None, side: int, what: str) -> float:
    """Return the focal length in pixels that shows `side` pixels in the full `angle` (radians)."""
    if angle is None or not 0 < angle < math.pi:
        text = f"{what} is {_shown(angle)}; it must be an angle in radians between 0 and pi"
        raise SceneError("CAMERA_INVALID", text)
    return side / (2 * math.tan(angle / 2))


def check_name(name: str) -> None:
    """Check that `name` can be the name of a file below a folder, on any system.

    Names come from files and become the names of outputs, so none may lead out of a folder.
    """
    if not 0 < len(name) <= MAX_NAME:
        text = f"the name is {_shown(name)}; it must be text of 1 to {MAX_NAME} characters"
    elif any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name):
        text = f"the name {_shown(name)} holds a control character or half of a surrogate pair"
    elif "\\" in name or name.startswith("/") or re.match("[A-Za-z]:", name):
        text = f"the name {_shown(name)} is absolute or has a backslash; it must be relative, with '/'"
    elif any(part in ("", ".", "..") for part in name.split("/")):
        text = f"the name {_shown(name)} has an empty part, '.' or '..'; it must go straight down"
    else:
        return
    raise SceneError("CAMERA_INVALID", text)


def _shown(value: object) -> str:
    return shorten(repr(value), 60)
