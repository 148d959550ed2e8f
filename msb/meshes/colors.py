"""Colour values of mesh files -> uint8, or float32 in [0, 1]."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import LINEAR, linear_to_srgb, srgb_to_linear

# Floats in [0, 1] that differ by less are one number, written by two programs.
_SAME = 1e-6


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
    opaque = 1 if colors.dtype.kind == "f" else np.iinfo(colors.dtype).max
    alpha = np.full((len(colors), 1), opaque, dtype=colors.dtype)
    return np.concatenate((colors, alpha), axis=1)


def as_floats(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return colours (N, 3 | 4), uint8 or float32, as a new float32 array in [0, 1]."""
    return np.asarray(colors / np.float32(255 if colors.dtype == np.uint8 else 1), np.float32)


def linear_light(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return sRGB colours (N, 3 | 4) as linear light; alpha stays as it is."""
    light = as_floats(colors)
    light[:, :3] = LINEAR[colors[:, :3]] if colors.dtype == np.uint8 else srgb_to_linear(colors[:, :3])
    return light


def srgb_colors(linear: NDArray[Any], most: int = 0) -> NDArray[Any]:
    """Return colours (N, 3 | 4) in linear light, uint8 or float32, as sRGB; alpha is what it was.

    They are uint8 where these stand for the values that are given, else float32. With `most` 65535 the floats
    stand for whole numbers up to that.
    """
    if linear.dtype == np.uint8:
        stored, most = linear, 255
    elif most == 65535:
        stored = _rounded(linear, most).astype(np.uint16)
    else:
        return _of_floats(linear)
    values, levels, stands = _table(most)
    color, alpha = stored[:, :3], stored[:, 3:]
    step = most // 255
    if stands[color].all() and not (alpha % step).any():
        return np.concatenate((levels[color], (alpha // step).astype(np.uint8)), axis=1)
    return np.concatenate((values[color], alpha / np.float32(most)), axis=1)


def _of_floats(linear: NDArray[Any]) -> NDArray[Any]:
    """Return float32 colours in linear light as sRGB, uint8 where these stand for them."""
    levels = _rounded(linear, 255)
    levels[:, :3] = _table(65535)[1][_rounded(linear[:, :3], 65535)]
    back: NDArray[Any] = np.concatenate((LINEAR[levels[:, :3]], levels[:, 3:] / np.float32(255)), axis=1)
    if (np.abs(back - linear) < _SAME).all():
        return levels.astype(np.uint8)
    return np.concatenate((linear_to_srgb(linear[:, :3]), linear[:, 3:]), axis=1)


def _rounded(values: NDArray[Any], most: int) -> NDArray[np.intp]:
    return np.asarray(np.rint(values * np.float32(most)).astype(np.intp))


@cache
def _table(most: int) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.bool_]]:
    """Return sRGB values of whole linear light, the nearest bytes, and which of these stand for them."""
    linear = np.arange(most + 1) / most
    values = linear_to_srgb(linear)
    levels = np.rint(values * 255).astype(np.uint8)
    stands = np.abs(srgb_to_linear(levels / 255) - linear) < 0.5 / most
    return values.astype(np.float32), levels, stands


def linear_colors(colors: NDArray[Any]) -> NDArray[Any]:
    """Return sRGB colours (N, 3 | 4) as linear light in whole numbers: bytes where these are off by less than
    half a level everywhere, else uint16.

    A level is one of the 255 steps of sRGB. Linear bytes are too coarse where it is dark; uint16 is off by a
    fortieth of a level at most. Alpha is linear as it is.
    """
    light = linear_light(colors)
    as_bytes = np.rint(light * 255)
    off = linear_to_srgb(as_bytes[:, :3] / np.float32(255)) - as_floats(colors[:, :3])
    if (np.abs(off) < 0.499 / 255).all():
        return as_bytes.astype(np.uint8)
    return np.rint(light * 65535).astype(np.uint16)
