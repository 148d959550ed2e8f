"""Generated cameras around or inside an asset, for assets that come without cameras."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.frame import parse_up
from msb.asset.look import up_axis
from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.framing import Framing, find_framing
from msb.scenes.paths import turntable, unit_at
from msb.scenes.poses import MAX_COORDINATE, look_at_pose

# Vertical field of view of cameras around an asset, in radians.
_FOV_Y = math.radians(40)
# Vertical field of view of cameras inside an asset, in radians.
_FOV_INSIDE = math.radians(60)
# Fraction of the faces that the search for the dense region ignores at each end of an axis.
_LEAST = 0.02
# Largest number of faces that are examined. If an asset has more faces, a sample of the faces is examined.
# The sample may miss a surface of few faces.
_SAMPLES = 200_000
# If the ratio of the two median distances is larger, `is_surrounded` returns True. In tests, the ratio was 4
# to 6 for captures with a background, and 0.7 to 1.5 for objects and empty rooms.
_SURROUNDED = 2.5
# Distance of a turntable camera. The unit is the distance at which the bounding sphere fills the image.
_MARGIN = 1.05
# Largest aspect ratio for images of a box, and the image size divided by the box size.
_MAX_RATIO, _BOX_MARGIN = 2.0, 1.1
# Default elevation of a turntable's cameras above the horizon, in degrees.
ELEVATION = 20.0


def make_turntable(
    asset: Asset,
    count: int,
    width: int = 960,
    height: int = 720,
    up: str | None = None,
    elevation: float = ELEVATION,
    framing: Framing | None = None,
) -> list[Camera]:
    """Return `count` turntable cameras around the asset, at `elevation` degrees above the horizon.

    `up` is the axis of the turntable, such as "+y". The default is the asset's `up_axis`. `framing` is the
    visible part of the asset. The default is all faces except far outliers. Raise CAMERA_PATH if the asset is
    too large or too far away for cameras.
    """
    sphere = framing or find_framing(asset)
    vector = _vector(up or up_axis(asset))
    narrow = min(_FOV_Y, 2 * math.atan(math.tan(_FOV_Y / 2) * width / height))
    distance = _MARGIN * (sphere.radius or 1e-6) / math.sin(narrow / 2)
    _check_reach(asset, sphere, distance)
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
    to_world = -np.asarray(asset.manifest.origin)
    named = (replace(camera, name=f"{index:05d}") for index, camera in enumerate(cameras))
    return [camera.relative_to(to_world) for camera in named]


def make_rings(
    asset: Asset,
    framing: Framing,
    rings: Iterable[tuple[float, int]],
    pixels: int,
    up: str | None = None,
) -> list[Camera]:
    """Return rings of cameras. The framed box fills each image.

    `rings` lists the elevation in degrees and the number of cameras for each ring. Images have about `pixels`
    pixels and the aspect ratio of the box.
    """
    axis = up or up_axis(asset)
    low, high = (np.array(corner) for corner in framing.box or ())
    center, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-6)
    upright = "xyz".index(axis[1])
    tall = float(half[upright])
    wide = float(np.linalg.norm(np.delete(half, upright)))
    # The image has the aspect ratio of the box, within limits. The distance of the camera is chosen for the
    # narrow side of the image.
    ratio = min(max(wide / tall, 1 / _MAX_RATIO), _MAX_RATIO)
    height = round(math.sqrt(pixels / ratio))
    width = round(height * ratio)
    tan_y = math.tan(_FOV_Y / 2) / max(1.0, ratio)
    distance = wide + _BOX_MARGIN * max(tall / tan_y, wide / (tan_y * ratio))
    _check_reach(asset, framing, distance)
    cameras = [
        camera
        for degrees, count in rings
        for camera in turntable(
            center,
            distance,
            up=_vector(axis),
            count=count,
            width=width,
            height=height,
            fov_y=2 * math.atan(tan_y),
            elevation=math.radians(degrees),
        )
    ]
    return [replace(camera, name=f"{index:05d}") for index, camera in enumerate(cameras)]


def _check_reach(asset: Asset, sphere: Framing, distance: float) -> None:
    """Raise CAMERA_PATH if cameras at `distance` from the framed part exceed the coordinate limit."""
    bounds = asset.manifest.bounds
    far = max(map(abs, sphere.center)) + distance
    if far > MAX_COORDINATE:
        reach = max(map(abs, (*bounds.min, *bounds.max)))
        text = f"its coordinates reach {reach:g}, so cameras around it reach {far:.3g}; "
        text += f"coordinates of cameras are limited to {MAX_COORDINATE:g}"
        raise SceneError("CAMERA_PATH", text, file=asset.opened_from)


class Bulk(NamedTuple):
    """The region that contains most faces of an asset. The region is computed in float64 from a sample of the
    faces.

    Outliers are ignored.
    """

    # (n, 3, 3) corners of all sampled faces, including outliers, relative to the asset's origin.
    corners: NDArray[np.float64]
    # (3,) bounds and median of the faces' centroids, without outliers.
    low: NDArray[np.float64]
    middle: NDArray[np.float64]
    high: NDArray[np.float64]


def find_bulk(asset: Asset, framing: Framing) -> Bulk:
    """Return the region that contains most of an asset's framed faces.

    Large assets are represented by an evenly spread sample of faces.
    """
    faces = asset.buffers["indices"]
    if framing.framed is not None:
        faces = faces[framing.framed]
    some = faces[:: max(1, len(faces) // _SAMPLES)]
    corners = asset.buffers["positions"][some].astype(np.float64)
    low, middle, high = np.quantile(corners.mean(axis=1), (_LEAST, 0.5, 1 - _LEAST), axis=0)
    return Bulk(corners, low, middle, high)


def place_inside(
    asset: Asset, framing: Framing, bulk: Bulk, outside: Iterable[Camera], up: str | None = None
) -> list[Camera]:
    """Return cameras inside an asset. Each camera is halfway between the middle and the surrounding faces.

    The cameras `outside` look at the framed part of the asset. For each camera in `outside`, the result has a
    camera on the same side with an image of the same size. Each inner camera is placed on one side and looks
    through the middle to the opposite side. If most of the asset is flat, the result is empty.
    """
    low, middle, high = bulk.low, bulk.middle, bulk.high
    if not (low < middle).all() or not (middle < high).all():
        return []
    vector = _vector(up or up_axis(asset))
    cameras, origin = [], np.asarray(asset.manifest.origin)
    for camera in outside:
        # Follow the ray from the middle in the direction `away`. For each axis, compute the point where the
        # ray leaves the box around most faces.
        away = camera.relative_to(origin).center - framing.center
        reach = np.where(away > 0, high - middle, middle - low) / np.maximum(np.abs(away), 1e-300)
        eye = middle + 0.5 * reach.min() * away
        pose = look_at_pose(eye, middle, vector)
        lens = Camera.from_fov(camera.width, camera.height, pose, fov_y=_FOV_INSIDE, name=camera.name)
        cameras.append(replace(lens, unit=unit_at(math.dist(eye, middle))).relative_to(-origin))
    return cameras


def is_surrounded(bulk: Bulk) -> bool:
    """Return whether a few large faces surround many small faces, like walls or hills in a capture.

    The area-weighted median distance depends on large surrounding faces. The median over the faces hardly
    depends on large surrounding faces.
    """
    middles = bulk.corners.mean(axis=1)
    kept = ((bulk.low <= middles) & (middles <= bulk.high)).all(axis=1)
    sides = bulk.corners[kept, 1:] - bulk.corners[kept, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    away = np.linalg.norm(middles[kept] - bulk.middle, axis=1)
    # Compute two median distances from the middle: weighted by area, and with equal weights for all faces.
    order = np.argsort(away)
    total = np.cumsum(area[order])
    if not total.size or not np.isfinite(total[-1]):
        return False
    half = away[order[np.searchsorted(total, total[-1] / 2)]]
    return bool(half >= _SURROUNDED * np.median(away) > 0)


def _vector(axis: str) -> list[float]:
    """Return the unit vector of an axis, given as text such as "-y" or as three numbers "X,Y,Z"."""
    return list(parse_up(axis))
