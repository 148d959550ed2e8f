"""Convert colours between number types, and between sRGB and linear light."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import LINEAR, linear_to_srgb, srgb_to_linear

# Two floats in [0, 1] count as equal if their difference is smaller, because other programs write rounded
# decimals.
_SAME = 1e-6


def stored_colors(values: NDArray[Any]) -> NDArray[Any]:
    """Return colours (N, 3 | 4) of any number type as uint8 or as float32 in [0, 1], in native byte order.

    Values of type uint8 are kept, and uint16 values are divided by 65535. Integer colours of other types are
    clamped to 0..255. Floats are clamped to 0..1, as glTF prescribes. Some programs write colour bytes as
    float numbers. Float colours become uint8 if they are whole numbers up to 255, with at least one value
    above 1. NaN becomes 0.
    """
    if values.dtype.kind == "f":
        values = np.nan_to_num(values, nan=0.0)
        bytes_as_floats = (values == np.floor(values)).all() and (values >= 0).all()
        if values.size and bytes_as_floats and 1 < values.max() <= 255:
            return values.astype(np.uint8)
        values = clamp_floats(values)
    elif values.dtype == np.uint16:
        values = values / 65535
    else:
        return values.clip(0, 255).astype(np.uint8)
    return values.astype(np.float32)


def clamp_floats(values: NDArray[Any]) -> NDArray[Any]:
    """Return float colours clamped to [0, 1]. NaN becomes 0."""
    return np.asarray(np.nan_to_num(values, nan=0.0).clip(0, 1))


def with_alpha(colors: NDArray[Any]) -> NDArray[Any]:
    """Return colours (N, 3 | 4) as (N, 4). A missing alpha channel is opaque."""
    if colors.shape[1] == 4:
        return colors
    opaque = 1 if colors.dtype.kind == "f" else np.iinfo(colors.dtype).max
    alpha = np.full((len(colors), 1), opaque, dtype=colors.dtype)
    return np.concatenate((colors, alpha), axis=1)


def as_floats(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return colours (N, 3 | 4), uint8 or float32, as a new float32 array in [0, 1]."""
    return np.asarray(colors / np.float32(255 if colors.dtype == np.uint8 else 1), np.float32)


def linear_light(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return sRGB colours (N, 3 | 4) as linear light in float32. Alpha is already linear."""
    light = as_floats(colors)
    light[:, :3] = LINEAR[colors[:, :3]] if colors.dtype == np.uint8 else srgb_to_linear(colors[:, :3])
    return light


def srgb_colors(linear: NDArray[Any], most: int = 0) -> NDArray[Any]:
    """Return linear colours (N, 3 | 4), uint8 or float32, as sRGB. Alpha is unchanged.

    The sRGB colours are uint8 if bytes represent all given values exactly. Otherwise, the sRGB colours are
    float32. If `most` is 65535, the float colours were stored as uint16 values in the file.
    """
    if linear.dtype == np.uint8:
        stored, most = linear, 255
    elif most == 65535:
        stored = _quantize(linear, most).astype(np.uint16)
    else:
        return _convert_floats(linear)
    values, levels, exact = _build_table(most)
    color, alpha = stored[:, :3], stored[:, 3:]
    step = most // 255
    if exact[color].all() and not (alpha % step).any():
        return np.concatenate((levels[color], (alpha // step).astype(np.uint8)), axis=1)
    return np.concatenate((values[color], alpha / np.float32(most)), axis=1)


def _convert_floats(linear: NDArray[Any]) -> NDArray[Any]:
    """Return linear float32 colours as sRGB: as uint8 if this is reversible, else as float32."""
    levels = _quantize(linear, 255)
    levels[:, :3] = _build_table(65535)[1][_quantize(linear[:, :3], 65535)]
    back: NDArray[Any] = np.concatenate((LINEAR[levels[:, :3]], levels[:, 3:] / np.float32(255)), axis=1)
    if (np.abs(back - linear) < _SAME).all():
        return levels.astype(np.uint8)
    return np.concatenate((linear_to_srgb(linear[:, :3]), linear[:, 3:]), axis=1)


def _quantize(values: NDArray[Any], most: int) -> NDArray[np.intp]:
    """Return values in [0, 1] as the nearest whole numbers from 0 to `most`."""
    return np.asarray(np.rint(values * np.float32(most)).astype(np.intp))


@cache
def _build_table(most: int) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.bool_]]:
    """For each linear level from 0 to `most`, return three arrays: the sRGB value, the nearest byte, and
    whether the byte is exact.

    A byte is exact if it converts back to the same linear level.
    """
    linear = np.arange(most + 1) / most
    values = linear_to_srgb(linear)
    levels = np.rint(values * 255).astype(np.uint8)
    exact = np.abs(srgb_to_linear(levels / 255) - linear) < 0.5 / most
    return values.astype(np.float32), levels, exact


def linear_colors(colors: NDArray[Any]) -> NDArray[Any]:
    """Return sRGB colours (N, 3 | 4) as linear light.

    The type is uint8 if the error is below half a level, else uint16. One colour level is 1/255 of the sRGB
    range. Linear light in 8 bits is too coarse for dark colours. The error of uint16 values is at most 1/40
    of a level.
    """
    light = linear_light(colors)
    as_bytes = np.rint(light * 255)
    error = linear_to_srgb(as_bytes[:, :3] / np.float32(255)) - as_floats(colors[:, :3])
    if (np.abs(error) < 0.499 / 255).all():
        return as_bytes.astype(np.uint8)
    return np.rint(light * 65535).astype(np.uint16)
