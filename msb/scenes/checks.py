"""Checks of the single values a camera is made of; each refuses with one clear error."""

from __future__ import annotations

import math
import operator
import re
import unicodedata
from typing import Literal, get_args

import numpy as np

from msb.errors import SceneError, shorten

Split = Literal["train", "val", "test"]
SPLITS: tuple[str, ...] = get_args(Split)

MAX_SIDE = 65535
"""Most pixels along a side, which JPEG and textures of any graphics card can hold."""
MAX_PIXELS = 1 << 28
"""Most pixels of an image: as float32 RGB they take 3 GiB, and a file that asks for more is wrong or
hostile."""
MIN_FOCAL, MAX_FOCAL = 1e-9, 1e9
"""Least and greatest focal length in pixels; beyond them a float32 renderer has a field of view of 180 or 0
degrees."""
MAX_NAME = 1024


def check_size(size: object) -> tuple[int, int]:
    """Return `size`, a pair, as integers (width, height) if an image can have that size."""
    if not isinstance(size, tuple | list) or len(size) != 2:
        raise SceneError("CAMERA_INVALID", f"the size is {_shown(size)}; it must be width and height")
    sides = _side("width", size[0]), _side("height", size[1])
    if sides[0] * sides[1] > MAX_PIXELS:
        text = f"{sides[0]} x {sides[1]} are {sides[0] * sides[1]} pixels; {MAX_PIXELS} are allowed"
        raise SceneError("CAMERA_INVALID", text)
    return sides


def _side(what: str, value: object) -> int:
    try:
        side = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        side = 0
    if isinstance(value, bool | np.bool_) or not 1 <= side <= MAX_SIDE:
        text = f"{what} is {_shown(value)}; it must be a whole number of pixels from 1 to {MAX_SIDE}"
        raise SceneError("CAMERA_INVALID", text)
    return side


def check_focal(what: str, value: object) -> float:
    """Return `value` as a float if it can be a focal length in pixels."""
    focal = _number(value)
    if not MIN_FOCAL <= focal <= MAX_FOCAL:
        text = f"{what} is {_shown(value)}; it must be a number of pixels from {MIN_FOCAL:g} to {MAX_FOCAL:g}"
        raise SceneError("CAMERA_INVALID", text)
    return focal


def check_principal(what: str, value: object) -> float:
    """Return `value` as a float if it can be a coordinate of the principal point in pixels."""
    place = _number(value)
    if not abs(place) <= MAX_FOCAL:
        text = f"{what} is {_shown(value)}; it must be a finite number of pixels, at most {MAX_FOCAL:g}"
        raise SceneError("CAMERA_INVALID", text)
    return place


def focal_from_fov(angle: float, side: int, what: str) -> float:
    """Return the focal length in pixels that shows `side` pixels in the full `angle` (radians)."""
    if not 0 < _number(angle) < math.pi:
        text = f"{what} is {_shown(angle)}; it must be an angle in radians between 0 and pi"
        raise SceneError("CAMERA_INVALID", text)
    return side / (2 * math.tan(angle / 2))


def check_name(name: object) -> None:
    """Check that `name` can be the name of a file below a folder, on any system.

    Names come from files and become the names of outputs, so none may lead out of a folder.
    """
    if not isinstance(name, str) or not 0 < len(name) <= MAX_NAME:
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


def check_split(split: object) -> None:
    """Check that `split` is one of `SPLITS`."""
    if split not in SPLITS:
        text = f"split is {_shown(split)}; it must be {', '.join(SPLITS)} or None"
        raise SceneError("CAMERA_INVALID", text)


def _number(value: object) -> float:
    """Return `value` as a float, NaN if it is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _shown(value: object) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    try:
        return shorten(repr(value), 60)
    except ValueError:
        return "a number of thousands of digits"
