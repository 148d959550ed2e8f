"""The frame of a captured scene: its up direction, the length of its unit, and the height of its floor.

Positions of an asset stay in the frame of the capture, like its cameras. Writers of mesh files rotate,
scale and lower the positions (`msb.meshes.placement`).
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msb.asset.manifest import FRAME_VERSION, Manifest
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.asset.asset import Asset

Vector = tuple[float, float, float]
# An up direction counts as an axis if the sine of the angle to the axis is below this value. Rounding an axis
# causes smaller angles.
_ROUNDED = 1e-6


@dataclass(frozen=True)
class Frame:
    """Known properties of the frame of a capture. Unknown properties are None.

    Attributes
    ----------
    up : (3,) floats, optional
        A unit vector.
    meters_per_unit : float, optional
        The length of the unit in metres.
    source : str
        The source of this length.
    floor : float, optional
        The height along `up`, in units, that files put at zero.
    """

    up: Vector | None = None
    meters_per_unit: float | None = None
    source: str = ""
    floor: float | None = None


def parse_up(text: str) -> Vector:
    """Return the unit vector of an axis such as "+z", or of three numbers "X,Y,Z"."""
    if len(text) == 2 and text[0] in "+-" and text[1] in "xyz":
        sign = -1.0 if text[0] == "-" else 1.0
        x, y, z = (sign if axis == text[1] else 0.0 for axis in "xyz")
        return x, y, z
    return unit_vector(parse_numbers(text, 3, "--up", "an axis such as +z, or X,Y,Z"))


def unit_vector(vector: Sequence[float]) -> Vector:
    """Return a vector scaled to length 1. A vector without a direction raises USAGE."""
    length = math.hypot(*vector)
    if not 0 < length < math.inf:
        raise UsageError("USAGE", "--up is zero; it must be a vector with a direction")
    x, y, z = (value / length for value in vector)
    return x, y, z


# For each suffix of a length, the unit in metres.
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3, "in": 0.0254, "ft": 0.3048}


def parse_length(text: str) -> float:
    """Return a length such as "1.2m", "120cm" or "4ft" in metres."""
    match = re.fullmatch(r"\s*([0-9.]{1,30}(?:[eE][+-]?\d{1,3})?)\s*([a-z]{1,2})\s*", text)
    value = 0.0
    if match is not None and match[2] in _LENGTHS:
        with contextlib.suppress(ValueError):
            value = float(match[1]) * _LENGTHS[match[2]]
    if not 0 < value < math.inf:
        units = ", ".join(_LENGTHS)
        text = f'the length is "{shorten(text, 40)}"; it must be a number with a unit ({units}), such as 1.2m'
        raise UsageError("USAGE", text)
    return value


def make_frame(
    up: str | None = None,
    scale: float | None = None,
    known_distance: Sequence[str] | None = None,
    floor: float | None = None,
) -> Frame | None:
    """Return the frame that a user describes, or None for an empty description.

    Parameters
    ----------
    up : str, optional
        An axis such as "-y", or "X,Y,Z".
    scale : float, optional
        The length of the unit in metres.
    known_distance : (str, str, str), optional
        Two points "X,Y,Z" in the capture, and the length between them, such as "1.2m".
    floor : float, optional
        As in `Frame`.

    Raises
    ------
    UsageError
        USAGE: a value is invalid, the points are equal, or both lengths are given.
    """
    source = ""
    if known_distance is not None:
        if scale is not None:
            raise UsageError("USAGE", "--known-distance cannot be combined with --scale; pass one of them")
        first, second, length = known_distance
        ends = [parse_numbers(end, 3, "a point of --known-distance", "X,Y,Z") for end in (first, second)]
        between = math.dist(*ends)
        if not between > 0:
            raise UsageError("USAGE", "the points of --known-distance are equal; pass two different points")
        scale, source = parse_length(length) / between, f"the length {length} between {first} and {second}"
    elif scale is not None:
        if not 1e-12 <= scale <= 1e12:
            text = f"the scale is {scale:g}; it must be the length of a unit in metres, from 1e-12 to 1e12"
            raise UsageError("USAGE", text)
        source = "given scale"
    frame = Frame(None if up is None else parse_up(up), scale, source[:200], floor)
    return None if frame == Frame() else frame


def parse_numbers(text: str, count: int, what: str, wanted: str) -> list[float]:
    """Return the finite numbers in a text such as "1,2,3"."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise UsageError("USAGE", f'{what} is "{shorten(text, 40)}"; it must be {wanted}')
    return numbers


def nearest_axis(vector: Sequence[float]) -> str:
    """Return the axis that is nearest to a vector, such as "-y"."""
    number = max(range(3), key=lambda k: abs(vector[k]))
    return ("-" if vector[number] < 0 else "+") + "xyz"[number]


def is_axis(vector: Vector) -> bool:
    """Return whether a unit vector is an axis, up to rounding."""
    return math.dist(vector, parse_up(nearest_axis(vector))) < _ROUNDED


def frame_of(manifest: Manifest) -> Frame | None:
    """Return the frame that an asset records, or None if the asset records no unit, floor or direction."""
    unit, up = manifest.unit or {}, manifest.up
    if not unit and up is None and manifest.floor is None:
        return None
    vector = None if up is None else parse_up(up)
    length = unit.get("meters_per_unit")
    return Frame(vector, None if length is None else float(length), unit.get("source", ""), manifest.floor)


def with_frame(asset: Asset, frame: Frame | None) -> Asset:
    """Return `asset` with a frame in its manifest. This function does not change positions.

    The coordinate frame gets the axis nearest to the up direction, for programs that support only axes.
    """
    if frame is None or frame == Frame():
        return asset
    manifest, up = asset.manifest, frame.up
    if up is not None:
        axis = nearest_axis(up)
        text = axis if is_axis(up) else ",".join(map(repr, up))
        coordinate_frame = replace(manifest.coordinate_frame, up=axis)
        manifest = replace(manifest, coordinate_frame=coordinate_frame, up=text)
    unit = {"meters_per_unit": frame.meters_per_unit, "source": frame.source or "unknown"}
    return replace(asset, manifest=replace(manifest, unit=unit, floor=frame.floor, version=FRAME_VERSION))
