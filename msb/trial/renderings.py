"""The pictures by which trials are judged: the standard tier over the cameras, against the mesh as it was."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import MsbError
from msb.meshes.assets import asset_from_mesh
from msb.metrics import psnr
from msb.metrics.registry import mean_of
from msb.render import Renderer
from msb.render.images import to_bytes
from msb.scenes import Camera
from msb.trial.mesh import TriedMesh

if TYPE_CHECKING:
    from msb.render import Frame
    from msb.views import Views

# Colour behind the mesh, before which neither dark nor bright surfaces disappear.
BACKGROUND = (0.5, 0.5, 0.5)
PICTURE_WIDTH = 480
_DARKEST = 0.4  # light on a face seen from its edge, relative to a face towards the camera


class Look:
    """What cameras see of a mesh as it was, and of what tasks made of it.

    `why_not` says why there are no pictures to judge by: no OpenCL device, or no camera that sees the mesh.
    All methods then return None or nothing. `unseeing` cameras saw none of the mesh, and are left out.
    """

    def __init__(self, mesh: TriedMesh, views: Views, device: str | None = None) -> None:
        self.mesh, self.views, self.cameras, self.device = mesh, views, views.cameras, device
        self.why_not: str | None = None
        self.unseeing = 0

    def psnr(self, mesh: TriedMesh) -> dict[str, Any]:
        """Return how much `mesh` looks like the mesh as it was.

        "psnr" is the mean over the cameras that see the mesh in dB, where equal pictures count 100, None
        without pictures; "same_pictures" says whether all are equal.
        """
        before = [image for image, _ in self._before]
        if not before:
            return {"psnr": None, "same_pictures": None}
        if not len(mesh.faces):
            mesh = _speck(mesh)
        return likeness(before, (to_bytes(frame.image) for frame in self._frames(mesh, self.cameras)))

    def visible_points(self, count: int) -> NDArray[np.float64] | None:
        """Return about `count` points (n, 3) of the surface that cameras see, evenly over their pixels."""
        depths = [depth for _, depth in self._before]
        if not depths:
            return None
        step = max(1, sum(int(np.count_nonzero(depth)) for depth in depths) // count)
        parts: list[NDArray[np.float64]] = []
        skip = 0
        for camera, depth in zip(self.cameras, depths, strict=True):
            pixels = np.flatnonzero(depth)[skip::step]
            skip = (skip - int(np.count_nonzero(depth))) % step
            row, column = np.divmod(pixels, camera.width)
            z = depth.reshape(-1)[pixels].astype(np.float64)
            x = (column + 0.5 - camera.cx) / camera.fx * z
            y = (row + 0.5 - camera.cy) / camera.fy * z
            points = np.stack([x, y, z, np.ones_like(z)], axis=1)
            parts.append((points @ camera.camera_to_world.T)[:, :3])
        return np.concatenate(parts)

    def empty_share(self, points: NDArray[np.float64], tolerance: float) -> float | None:
        """Return the share of `points` (n, 3) at which some camera sees that there is nothing.

        A point is empty if a camera has it in its picture more than `tolerance` before the surface that is
        drawn there, or where none is drawn. Points in no picture do not count; None if all are such.
        """
        depths = [depth for _, depth in self._before]
        if not depths:
            return None
        seen = np.zeros(len(points), bool)
        empty = np.zeros(len(points), bool)
        for camera, depth in zip(self.cameras, depths, strict=True):
            pixels, z = camera.project(points)
            with np.errstate(invalid="ignore"):
                column, row = np.floor(pixels).T
                inside = (
                    (z > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
                )
            there = depth[row[inside].astype(int), column[inside].astype(int)]
            seen |= inside
            empty[inside] |= (there == 0) | (z[inside] < there - tolerance)
        return float(np.count_nonzero(empty) / np.count_nonzero(seen)) if seen.any() else None

    def picture(self, mesh: TriedMesh, camera: Camera | None = None) -> NDArray[np.uint8] | None:
        """Return a small picture (H, W, 3) of `mesh`: from `camera` as it is, else from the first, shaded."""
        if not len(mesh.faces) or (camera is None and not self.cameras):
            return None
        if camera is None:
            first = self.cameras[0]
            camera = first.scaled(min(1.0, PICTURE_WIDTH / first.width))
            mesh = _shaded(mesh, camera)
        for frame in self._frames(mesh, [camera]):
            return to_bytes(frame.image)
        return None

    @cached_property
    def _before(self) -> list[tuple[NDArray[np.uint8], NDArray[np.float32]]]:
        """Image and depths of the mesh as it was, of each camera that sees it; `cameras` are those then."""
        drawn = [
            (camera, to_bytes(frame.image), np.array(frame.depth), bool((frame.alpha > 0).any()))
            for camera, frame in zip(self.cameras, self._frames(self.mesh, self.cameras), strict=False)
        ]
        seeing = [(camera, image, depth) for camera, image, depth, sees in drawn if sees]
        if not seeing and self.why_not is None:
            self.why_not = self.views.nothing
        self.unseeing = len(drawn) - len(seeing)
        self.cameras = [camera for camera, _, _ in seeing] or self.cameras
        return [(image, depth) for _, image, depth in seeing]

    def _frames(self, mesh: TriedMesh, cameras: Sequence[Camera]) -> Iterator[Frame]:
        """Yield what each camera sees; nothing where there is no device to draw on."""
        try:
            renderer = Renderer(asset_from_mesh(mesh.to_mesh()), "standard", self.device)
        except MsbError as error:
            if error.code != "DEVICE_NOT_FOUND":
                raise
            self.why_not = error.message
            return
        with contextlib.closing(renderer):
            for camera in cameras:
                yield renderer.render(camera, BACKGROUND)


def likeness(before: Iterable[NDArray[np.uint8]], after: Iterable[NDArray[np.uint8]]) -> dict[str, Any]:
    """Return how much pictures look like those before them, as `Look.psnr` does."""
    values = [psnr(now, was) for was, now in zip(before, after, strict=True)]
    return {"psnr": mean_of(values), "same_pictures": bool(np.isinf(values).all())}


def facing(size: int = PICTURE_WIDTH) -> Camera:
    """Return a camera that sees the unit square of the plane z = 0 as a picture of `size` pixels a side."""
    return Camera.look_at(
        (0.5, 0.5, -10.0), (0.5, 0.5, 0.0), up=(0, -1, 0), width=size, height=size, fov_y=0.104
    )


def random_colors(labels: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return a bright colour (n, 3) for each label, the same every time; labels below 0 are black."""
    labels = np.maximum(labels, -1)
    palette = np.random.default_rng(7).uniform(0.25, 1.0, (int(labels.max(initial=0)) + 2, 3))
    palette[-1] = 0.0
    return palette[labels].astype(np.float32)


def _shaded(mesh: TriedMesh, camera: Camera) -> TriedMesh:
    """Return the mesh with faces of their own, darker the more they are turned away: to show their shape."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = camera.center - corners.mean(axis=1)
    sizes = np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1)
    facing = np.abs((normals * towards).sum(axis=1)) / np.maximum(sizes, np.finfo(np.float64).tiny)
    light = np.repeat(_DARKEST + (1 - _DARKEST) * facing, 3)[:, None]
    colors = mesh.colors[mesh.faces.reshape(-1)] * light
    return mesh.unshared(colors.astype(np.float32))


def _speck(mesh: TriedMesh) -> TriedMesh:
    """Return a mesh of one face without area, which draws nothing: an asset must have a face."""
    point = mesh.vertices[:1] if len(mesh.vertices) else np.zeros((1, 3), np.float32)
    return TriedMesh(point, np.zeros((1, 3), np.int64), np.ones((1, 3), np.float32))
