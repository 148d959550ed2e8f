"""Background colours: their names on the command line and in Python, and their validation."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from msb.errors import UsageError, shorten

# Red, green and blue in the colour space of the image.
Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)
BLACK: Color = (0.0, 0.0, 0.0)
NAMED = {"black": BLACK, "white": WHITE}


def parse_color(text: str, official: object = None) -> Color | None:
    """Return the colour that `text` describes, or None if the text is invalid.

    Valid texts are black, white, #rrggbb, r,g,b in 0..1, and "official". For "official", the result is the
    argument `official`.
    """
    word = text.strip().lower()
    if word == "official":
        word = str(official)
    if re.fullmatch(r"#[0-9a-f]{6}", word):
        red, green, blue = (int(word[i : i + 2], 16) / 255 for i in (1, 3, 5))
        return red, green, blue
    try:
        return unit_color(word.split(","))
    except ValueError:
        return NAMED.get(word)


def unit_color(values: Iterable[float | str]) -> Color | None:
    """Return three numbers as a colour, or None if a number is outside 0 to 1."""
    red, green, blue = map(float, values)
    return (red, green, blue) if all(0 <= value <= 1 for value in (red, green, blue)) else None


def check_background(background: object, official: object = None) -> Color:
    """Return a background as a colour.

    Three finite numbers are returned as a tuple. A text is parsed by `parse_color`.
    """
    color = parse_color(background, official) if isinstance(background, str) else _three_numbers(background)
    if color is None:
        text = f"background is {shorten(repr(background), 60)}; pass three finite numbers, "
        raise UsageError(
            "USAGE", text + 'or a text: "black", "white", "#rrggbb", "r,g,b" in 0..1, "official"'
        )
    return color


def _three_numbers(values: Any) -> Color | None:
    """Return three finite numbers as a colour. For any other value, return None."""
    try:
        array = np.asarray(values)
    except Exception:  # the value has an irregular shape, or NumPy cannot convert it
        return None
    if array.shape != (3,) or array.dtype.kind not in "fiu" or np.ma.is_masked(values):
        return None
    with np.errstate(over="ignore"):
        if not np.isfinite(array.astype(np.float32)).all():
            return None
    red, green, blue = map(float, array)
    return red, green, blue
