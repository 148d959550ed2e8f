"""The camera class of the package: a pinhole camera with the axes of OpenCV."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.base.origin import NO_ORIGIN
from msb.errors import SceneError, shorten
from msb.scenes.checks import (
    MAX_SIDE,
    MIN_FOCAL,
    SPLITS,
    Split,
    check_name,
    check_pixels,
    check_size,
    focal_from_fov,
)
from msb.scenes.distortion import Distortion
from msb.scenes.poses import check_pose, look_at_pose, rigid_inverse

_Frame = TypeVar("_Frame", bound=Any)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: x_camera = W x_world, then u = fx x / z + cx, v = fy y / z + cy.

    Axes follow OpenCV: x right, y down, z forward. Pixel (0, 0) has its centre at u, v = (0.5, 0.5). The
    The image spans u in [0, width] and v in [0, height].

    Parameters
    ----------
    width, height : int
        Size of the image in pixels; at most `MAX_SIDE` per side and `MAX_PIXELS` in total.
    fx, fy : float
        Focal lengths in pixels.
    cx, cy : float
        Principal point in pixels; (width / 2, height / 2) is the centre.
    world_to_camera : (4, 4) array_like
        The matrix W for column vectors, stored as a read-only float64 copy. The rotation must be orthonormal
        to 2e-4 with determinant +1, and the last row must be 0 0 0 1. A rotation with a larger error than
        1e-4 is replaced by the nearest rotation.
    name : str, optional
        A relative path with forward slashes, usually the image's file name below its folder.
    image_path : Path, optional
        The path of the photograph in the dataset; the file may be missing.
    source_size : (int, int), optional
        The recorded image width and height, if this camera has another size.
    split : {"train", "val", "test"}, optional
        The part of the dataset that contains the camera, if the dataset states it.
    unit : float
        The world length that renderers use as depth 1. The near plane of the standard tier is at depth 0.01.
        The unit is 1, except for cameras around very small or large objects (`msb.scenes.turntable`).
    distortion : Distortion, optional
        The distortion of the lens that took the photograph at `image_path`. Projection and renderers ignore
        the distortion. Photographs are undistorted by `msb.scenes.lenses`.

    Raises
    ------
    SceneError
        CAMERA_INVALID.

    Examples
    --------
    >>> import numpy as np
    >>> camera = Camera(640, 480, 500, 500, 320, 240, np.eye(4))
    >>> pixels, depth = camera.project([[0, 0, 2], [0.2, -0.1, 1]])
    >>> pixels.tolist(), depth.tolist()
    ([[320.0, 240.0], [420.0, 190.0]], [2.0, 1.0])
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: NDArray[np.float64]
    name: str | None = None
    image_path: Path | None = None
    source_size: tuple[int, int] | None = None
    split: Split | None = None
    unit: float = 1.0
    distortion: Distortion | None = None

    def __post_init__(self) -> None:
        width, height = check_size((self.width, self.height))
        pose = check_pose(self.world_to_camera, "world_to_camera")
        pose.setflags(write=False)
        values: dict[str, Any] = {"width": width, "height": height, "world_to_camera": pose}
        # Convert all values to Python numbers. Python numbers can be compared and written as JSON.
        values |= {key: check_pixels(key, getattr(self, key), MIN_FOCAL) for key in ("fx", "fy")}
        values |= {key: check_pixels(key, getattr(self, key)) for key in ("cx", "cy")}
        if self.name is not None:
            check_name(self.name)
        if self.image_path is not None:
            values["image_path"] = Path(self.image_path)
        if self.source_size is not None:
            values["source_size"] = check_size(self.source_size)
        if self.split not in (None, *SPLITS):
            text = f"split is {shorten(repr(self.split), 60)}; it must be {', '.join(SPLITS)} or None"
            raise SceneError("CAMERA_INVALID", text)
        if not 0 < self.unit < math.inf:
            raise SceneError("CAMERA_INVALID", f"unit is {self.unit}; it must be a positive length")
        values["unit"] = float(self.unit)  # JSON cannot store NumPy numbers
        for key, value in values.items():
            object.__setattr__(self, key, value)

    @classmethod
    def from_fov(
        cls,
        width: int,
        height: int,
        world_to_camera: ArrayLike,
        *,
        fov_x: float | None = None,
        fov_y: float | None = None,
        name: str | None = None,
    ) -> Camera:
        """Return a camera with a centred principal point and the given full angles of view in radians.

        If only one angle is given, pixels are square.
        """
        width, height = check_size((width, height))
        fx = None if fov_x is None else focal_from_fov(fov_x, width, "fov_x")
        fy = fx if fx is not None and fov_y is None else focal_from_fov(fov_y, height, "fov_y")
        pose = cast("NDArray[np.float64]", world_to_camera)  # the constructor checks the type
        return cls(width, height, fy if fx is None else fx, fy, width / 2, height / 2, pose, name)

    @classmethod
    def look_at(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        *,
        up: ArrayLike = (0.0, -1.0, 0.0),
        width: int,
        height: int,
        fov_y: float,
        name: str | None = None,
    ) -> Camera:
        """Return a camera at `eye` that looks at `target`, with square pixels.

        `up` is the world direction that points up in the image. The up direction is -y in most COLMAP scenes
        and their models, (0, 1, 0) for mesh files, and (0, 0, 1) in NeRF-Synthetic and Blender. `fov_y` is
        the full vertical angle in radians.
        """
        return cls.from_fov(width, height, look_at_pose(eye, target, up), fov_y=fov_y, name=name)

    @property
    def K(self) -> NDArray[np.float64]:  # noqa: N802 - the usual name
        """The intrinsic matrix, (3, 3) float64."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @cached_property
    def camera_to_world(self) -> NDArray[np.float64]:
        """The inverse of `world_to_camera`, (4, 4) float64, read-only."""
        inverse = rigid_inverse(self.world_to_camera)
        inverse.setflags(write=False)
        return inverse

    @property
    def center(self) -> NDArray[np.float64]:
        """The camera's position in the world, (3,) float64, read-only."""
        return self.camera_to_world[:3, 3]

    @property
    def fov_x(self) -> float:
        """Full horizontal angle in radians, for a centred principal point."""
        return 2 * math.atan(self.width / (2 * self.fx))

    @property
    def fov_y(self) -> float:
        """Full vertical angle in radians, for a centred principal point."""
        return 2 * math.atan(self.height / (2 * self.fy))

    def project(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project points (..., 3).

        Return pixels (..., 2) float64, and depths (...) along the camera's z axis.

        Pixel coordinates are u to the right and v down. Coordinates of points with a depth of 0 or less are
        NaN.
        """
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        local = np.asarray(points, dtype=np.float64) @ rotation.T + translation
        depth = local[..., 2]
        with np.errstate(invalid="ignore"):
            seen = np.where(depth > 0, depth, np.nan)[..., None]
            return local[..., :2] / seen * (self.fx, self.fy) + (self.cx, self.cy), depth

    def resized(self, width: int, height: int) -> Camera:
        """Return this camera with an image of another size.

        Each axis is scaled separately, so the angles of view do not change. The old size is stored as
        `source_size`, unless the camera already has a `source_size`.
        """
        width, height = check_size((width, height))
        if (width, height) == (self.width, self.height):
            return self
        x, y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * x,
            fy=self.fy * y,
            cx=self.cx * x,
            cy=self.cy * y,
            source_size=self.source_size or (self.width, self.height),
        )

    def scaled(self, factor: float) -> Camera:
        """Return the camera for the same image scaled by `factor`. Image sides are rounded to whole pixels,
        and halves are rounded up.

        Focal lengths and principal point follow the rounded size. Datasets round sizes in different ways. If
        the image exists, pass its size to `resized` instead of a factor.
        """
        if not 0 < factor <= MAX_SIDE:
            text = f"the scale factor is {factor}; it must be positive and at most {MAX_SIDE}"
            raise SceneError("CAMERA_INVALID", text)
        sides = (max(1, math.floor(side * factor + 0.5)) for side in (self.width, self.height))
        return self.resized(*sides)

    def relative_to(self, origin: ArrayLike) -> Camera:
        """Return the camera in coordinates relative to `origin`, such as the origin of an asset."""
        if not np.any(origin):
            return self
        pose = self.world_to_camera.copy()
        pose[:3, 3] += pose[:3, :3] @ np.asarray(origin, np.float64)
        return replace(self, world_to_camera=pose)

    def in_units(self, origin: ArrayLike = NO_ORIGIN) -> Camera:
        """Return the camera for renderers. The lengths and depths of the camera are multiples of `unit`.

        The result is relative to `origin`, like the positions of an asset.
        """
        if np.any(origin):
            return self.relative_to(origin).in_units()
        if self.unit == 1:
            return self
        pose = self.world_to_camera.copy()
        pose[:3] /= self.unit
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return _InUnits(**{**values, "world_to_camera": pose, "unit": 1.0})

    def in_world(self, frame: _Frame) -> _Frame:
        """Convert the depths of a frame that was rendered with `in_units()` to scene units."""
        if self.unit == 1:
            return frame
        planes = {name: getattr(frame, name) for name in ("depth", "depth_median")}
        scaled = {name: x * x.dtype.type(self.unit) for name, x in planes.items() if x is not None}
        return replace(frame, **scaled)

    def centered(self) -> Camera:
        """Return the camera with its principal point in the middle of the image.

        The 3DGS family ignores cx and cy and renders this camera (`graphdeco-inria/gaussian-splatting`:
        scene/dataset_readers.py, utils/graphics_utils.py).
        """
        return replace(self, cx=self.width / 2, cy=self.height / 2)

    def _values(self) -> tuple[Any, ...]:
        return tuple(getattr(self, field.name) for field in fields(self))

    def _key(self) -> tuple[Any, ...]:
        return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in self._values())

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Camera) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        # Unpickled arrays are writable, so call the constructor, which makes them read-only.
        return Camera, self._values()


class _InUnits(Camera):
    """A camera with scaled axes, whose pose is not validated."""

    def __post_init__(self) -> None:
        self.world_to_camera.setflags(write=False)
