"""Standard-tier renderings of the original mesh and of results, and their comparison."""

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
from msb.trial.mesh import TrialMesh
from msb.views import measure_coverage

if TYPE_CHECKING:
    from msb.render import Frame
    from msb.views import ChosenViews

# Background colour: grey contrasts with both dark and bright surfaces.
BACKGROUND = (0.5, 0.5, 0.5)
# Width of the saved images in pixels.
PICTURE_WIDTH = 480
# Brightness of faces that are viewed edge-on in saved images. A face that points at the camera has the
# brightness 1.
_DARKEST = 0.4


class Renderings:
    """Renderings of the original mesh by all cameras, and comparisons of results with these renderings.

    Results cannot be compared without an OpenCL device, without a camera that sees the mesh, or if the mesh
    covers too few pixels. In these cases, `why_not` is the reason, and all methods return None or an empty
    result. The field `blind_cameras` is the number of cameras that do not see the mesh and are ignored.
    """

    def __init__(self, mesh: TrialMesh, views: ChosenViews, device: str | None = None) -> None:
        self.mesh, self.views, self.cameras, self.device = mesh, views, views.cameras, device
        self.why_not: str | None = None
        self.blind_cameras = 0

    def psnr(self, mesh: TrialMesh) -> dict[str, Any]:
        """Compare renderings of `mesh` with renderings of the original mesh.

        The value "psnr" is the average PSNR over the cameras in dB, or None without renderings. Equal images
        have a PSNR of 100 dB. The value "same_pictures" is true if all images are equal.
        """
        original = [image for image, _ in self._originals]
        if not original:
            return {"psnr": None, "same_pictures": None}
        if not len(mesh.faces):
            mesh = _make_invisible_mesh(mesh)
        return compare_images(original, (to_bytes(frame.image) for frame in self._frames(mesh, self.cameras)))

    def visible_points(self, count: int) -> NDArray[np.float64] | None:
        """Return about `count` points (n, 3) of the visible surface, evenly distributed over the pixels."""
        depths = [depth for _, depth in self._originals]
        if not depths:
            return None
        # Select every `step`-th covered pixel, counted over all images. `skip` is the number of covered
        # pixels before the first sample of the current image.
        step = max(1, sum(int(np.count_nonzero(depth)) for depth in depths) // count)
        parts: list[NDArray[np.float64]] = []
        skip = 0
        for camera, depth in zip(self.cameras, depths, strict=True):
            pixels = np.flatnonzero(depth)[skip::step]
            skip = (skip - int(np.count_nonzero(depth))) % step
            # Unproject the pixel centres and their depths to world coordinates.
            row, column = np.divmod(pixels, camera.width)
            z = depth.reshape(-1)[pixels].astype(np.float64)
            x = (column + 0.5 - camera.cx) / camera.fx * z
            y = (row + 0.5 - camera.cy) / camera.fy * z
            points = np.stack([x, y, z, np.ones_like(z)], axis=1)
            parts.append((points @ camera.camera_to_world.T)[:, :3])
        return np.concatenate(parts)

    def empty_share(self, points: NDArray[np.float64], tolerance: float) -> float | None:
        """Return the fraction of `points` (n, 3) that lie in empty space for at least one camera.

        A camera sees empty space at a point in two cases. In the first case, the pixel of the point shows the
        background. In the second case, the point is more than `tolerance` in front of the visible surface.
        Points outside all images are ignored. The fraction is None if no point is in an image.
        """
        depths = [depth for _, depth in self._originals]
        if not depths:
            return None
        in_image = np.zeros(len(points), bool)
        is_empty = np.zeros(len(points), bool)
        for camera, depth in zip(self.cameras, depths, strict=True):
            # Project the points, and compare their depths with the surface depths at their pixels.
            pixels, z = camera.project(points)
            with np.errstate(invalid="ignore"):
                column, row = np.floor(pixels).T
                inside = (
                    (z > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
                )
            surface = depth[row[inside].astype(int), column[inside].astype(int)]
            in_image |= inside
            is_empty[inside] |= (surface == 0) | (z[inside] < surface - tolerance)
        return float(np.count_nonzero(is_empty) / np.count_nonzero(in_image)) if in_image.any() else None

    def picture(self, mesh: TrialMesh, camera: Camera | None = None) -> NDArray[np.uint8] | None:
        """Return a small image (H, W, 3) of `mesh`. Return None without a device or without faces.

        The camera `camera` renders the image. The default is the first camera, with faces shaded by their
        angle to the camera.
        """
        if not len(mesh.faces) or (camera is None and not self.cameras):
            return None
        if camera is None:
            first = self.cameras[0]
            camera = first.scaled(min(1.0, PICTURE_WIDTH / first.width))
            mesh = _shade_faces(mesh, camera)
        for frame in self._frames(mesh, [camera]):
            return to_bytes(frame.image)
        return None

    @cached_property
    def _originals(self) -> list[tuple[NDArray[np.uint8], NDArray[np.float32]]]:
        """The images and depths of the original mesh, for each camera that sees the mesh.

        Reading this property removes all other cameras from `cameras`.
        """
        rendered = [
            (to_bytes(frame.image), np.array(frame.depth), measure_coverage(frame))
            for frame in self._frames(self.mesh, self.cameras)
        ]
        if len(rendered) < len(self.cameras):  # without a device
            return []
        covered = {number: share for number, (_, _, share) in enumerate(rendered) if share}
        chosen = self.views.with_covered(covered)
        self.blind_cameras = len(rendered) - len(covered)
        self.cameras = chosen.cameras or self.cameras
        self.why_not = chosen.why_not
        return [] if self.why_not else [rendered[number][:2] for number in covered]

    def _frames(self, mesh: TrialMesh, cameras: Sequence[Camera]) -> Iterator[Frame]:
        """Yield the images and depths of each camera. Yield nothing without an OpenCL device."""
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


def compare_images(
    originals: Iterable[NDArray[np.uint8]], images: Iterable[NDArray[np.uint8]]
) -> dict[str, Any]:
    """Return the average PSNR of `images` against `originals`, and whether all images are equal.

    The keys are explained at `Renderings.psnr`.
    """
    values = [psnr(image, original) for original, image in zip(originals, images, strict=True)]
    return {"psnr": mean_of(values), "same_pictures": bool(np.isinf(values).all())}


def make_facing_camera(size: int = PICTURE_WIDTH) -> Camera:
    """Return a camera whose image (`size` x `size` pixels) shows the unit square of the plane z = 0."""
    return Camera.look_at(
        (0.5, 0.5, -10.0), (0.5, 0.5, 0.0), up=(0, -1, 0), width=size, height=size, fov_y=0.104
    )


def random_colors(labels: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return a bright, reproducible colour (n, 3) for each label (n,). Negative labels are black."""
    labels = np.maximum(labels, -1)
    palette = np.random.default_rng(7).uniform(0.25, 1.0, (int(labels.max(initial=0)) + 2, 3))
    palette[-1] = 0.0
    return palette[labels].astype(np.float32)


def _shade_faces(mesh: TrialMesh, camera: Camera) -> TrialMesh:
    """Return the triangle soup of the mesh, with faces shaded by their angle to the camera."""
    # Cosine (F,) of the angle between the face normal and the direction to the camera.
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = camera.center - corners.mean(axis=1)
    sizes = np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1)
    cosine = np.abs((normals * towards).sum(axis=1)) / np.maximum(sizes, np.finfo(np.float64).tiny)
    light = np.repeat(_DARKEST + (1 - _DARKEST) * cosine, 3)[:, None]
    colors = mesh.colors[mesh.faces.reshape(-1)] * light
    return mesh.unshared(colors.astype(np.float32))


def _make_invisible_mesh(mesh: TrialMesh) -> TrialMesh:
    """Return a mesh of a single face without area, because an asset must have at least one face."""
    point = mesh.vertices[:1] if len(mesh.vertices) else np.zeros((1, 3), np.float32)
    return TrialMesh(point, np.zeros((1, 3), np.int64), np.ones((1, 3), np.float32))
