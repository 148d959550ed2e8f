"""Cameras around an asset, for when it brings none."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from msb.asset.look import up_axis
from msb.scenes.paths import turntable

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes.camera import Camera

_FOV_Y = math.radians(40)
_MARGIN = 1.05
"""A turntable's distance, relative to that at which the bounding sphere fills the image."""
ELEVATION = 20.0
"""Degrees of a turntable's cameras above the horizon."""


def around(
    asset: Asset,
    count: int,
    width: int = 960,
    height: int = 720,
    up: str | None = None,
    elevation: float = ELEVATION,
) -> list[Camera]:
    """Return a turntable of `count` cameras that see all of the asset.

    Parameters
    ----------
    asset : Asset
    count : int
    width, height : int
        Size of the images in pixels.
    up : str, optional
        The axis of the turntable, such as "+y"; the asset's own if not given, where that is unknown that of
        `up_axis`.
    elevation : float
        Degrees above the horizon.
    """
    sphere = asset.manifest.bounding_sphere
    axis = up or up_axis(asset)
    vector = [0.0, 0.0, 0.0]
    vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
    narrow = min(_FOV_Y, 2 * math.atan(math.tan(_FOV_Y / 2) * width / height))
    distance = _MARGIN * (sphere.radius or 1e-6) / math.sin(narrow / 2)
    cameras = turntable(
        sphere.center,
        distance,
        up=vector,
        count=count,
        width=width,
        height=height,
        fov_y=_FOV_Y,
        elevation=math.radians(elevation),
    )
    return [replace(camera, name=f"{index:05d}") for index, camera in enumerate(cameras)]
