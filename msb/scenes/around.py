"""Cameras around an asset, for when it brings none."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import up_axis
from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.paths import turntable, unit_at
from msb.scenes.poses import MAX_COORDINATE, look_at_pose

_FOV_Y = math.radians(40)
_FOV_INSIDE = math.radians(60)
# Share of the faces, on each side, that do not count where most of them are looked for.
_LEAST = 0.02
# Faces that are looked at; rarer ones of a larger asset may be missed.
_SAMPLES = 200_000
# Captures before walls have 4 to 6, things and empty rooms 0.7 to 1.5.
_SURROUNDED = 2.5
# A turntable's distance, relative to that at which the bounding sphere fills the image.
_MARGIN = 1.05
# Degrees of a turntable's cameras above the horizon.
ELEVATION = 20.0


def around(
    asset: Asset,
    count: int,
    width: int = 960,
    height: int = 720,
    up: str | None = None,
    elevation: float = ELEVATION,
) -> list[Camera]:
    """Return a turntable of `count` cameras that see all of the asset, so many degrees above the horizon.

    Its axis `up`, such as "+y", is the asset's own if not given (`up_axis`). `CAMERA_PATH` names the asset's
    file where it is too large or too far away for cameras.
    """
    sphere = asset.manifest.bounding_sphere
    vector = _vector(up or up_axis(asset))
    narrow = min(_FOV_Y, 2 * math.atan(math.tan(_FOV_Y / 2) * width / height))
    distance = _MARGIN * (sphere.radius or 1e-6) / math.sin(narrow / 2)
    _check_reach(asset, distance)
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


def _check_reach(asset: Asset, distance: float) -> None:
    """Refuse an asset around which no camera can stand `distance` from its middle."""
    bounds, sphere = asset.manifest.bounds, asset.manifest.bounding_sphere
    far = max(map(abs, sphere.center)) + distance
    if far > MAX_COORDINATE:
        reach = max(map(abs, (*bounds.min, *bounds.max)))
        text = f"its coordinates reach {reach:g}, cameras around it {far:.3g}"
        text = f"{text}; views can be made up to {MAX_COORDINATE:g}"
        raise SceneError("CAMERA_PATH", text, file=asset.opened_from)


class Bulk(NamedTuple):
    """Where most faces of an asset are, float64, of a sample of them: a few far ones do not count."""

    # (n, 3, 3), those of far faces included.
    corners: NDArray[np.float64]
    low: NDArray[np.float64]
    middle: NDArray[np.float64]
    # (3,) the bounds and the median of the middles of faces.
    high: NDArray[np.float64]


def bulk_of(asset: Asset) -> Bulk:
    """Return where most faces of an asset are; of large assets, evenly spread ones are looked at."""
    faces = asset.buffers["indices"]
    some = faces[:: max(1, len(faces) // _SAMPLES)]
    corners = asset.buffers["positions"][some].astype(np.float64)
    low, middle, high = np.quantile(corners.mean(axis=1), (_LEAST, 0.5, 1 - _LEAST), axis=0)
    return Bulk(corners, low, middle, high)


def inside(asset: Asset, bulk: Bulk, outside: Iterable[Camera], up: str | None = None) -> list[Camera]:
    """Return cameras within an asset that look across its middle, half-way out to what encloses it.

    There is one for each that looks at it from `outside`, on the same side and of the same size; none where
    most of the asset has no extent.
    """
    low, middle, high = bulk.low, bulk.middle, bulk.high
    if not (low < middle).all() or not (middle < high).all():
        return []
    vector = _vector(up or up_axis(asset))
    cameras = []
    for camera in outside:
        away = camera.center - asset.manifest.bounding_sphere.center
        reach = np.where(away > 0, high - middle, middle - low) / np.maximum(np.abs(away), 1e-300)
        eye = middle + 0.5 * reach.min() * away
        pose = look_at_pose(eye, middle, vector)
        lens = Camera.from_fov(camera.width, camera.height, pose, fov_y=_FOV_INSIDE, name=camera.name)
        cameras.append(replace(lens, unit=unit_at(math.dist(eye, middle))))
    return cameras


def surrounded(bulk: Bulk) -> bool:
    """Return whether a few large faces are round many small ones, as walls or hills are in a capture.

    Then half of the area is far further from the middle than half of the faces.
    """
    middles = bulk.corners.mean(axis=1)
    kept = ((bulk.low <= middles) & (middles <= bulk.high)).all(axis=1)
    sides = bulk.corners[kept, 1:] - bulk.corners[kept, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    away = np.linalg.norm(middles[kept] - bulk.middle, axis=1)
    order = np.argsort(away)
    total = np.cumsum(area[order])
    if not total.size or not np.isfinite(total[-1]):
        return False
    half = away[order[np.searchsorted(total, total[-1] / 2)]]
    return bool(half >= _SURROUNDED * np.median(away) > 0)


def _vector(axis: str) -> list[float]:
    vector = [0.0, 0.0, 0.0]
    vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
    return vector
