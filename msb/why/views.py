"""The views of one asset, drawn in the ways that causes of a worse look compare."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import daylight, up_axis
from msb.asset.tiers import why_not
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.render import Renderer
from msb.render.device_scope import in_turn
from msb.render.images import to_bytes
from msb.render.standard.renderer import StandardRenderer

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.meshes.mesh import Mesh
    from msb.registry import Tier
    from msb.render import Frame
    from msb.scenes import Camera
    from msb.views import Views as ChosenViews

    Image = NDArray[np.float32]


EQUAL = 90.0
"""dB from which on images differ by rounding alone."""


class DoesNotApplyError(Exception):
    """The asset cannot be drawn with this cause; the text says why."""


class Views:
    """The views of one asset, drawn in its different ways; each way is drawn once."""

    def __init__(
        self,
        asset: Asset,
        views: ChosenViews,
        background: tuple[float, float, float],
        device: str | None,
    ) -> None:
        self.asset, self.cameras, self.background, self.device = asset, views.cameras, background, device
        self._blind = None if views.cameras else views.nothing
        self._official: list[Image] | None = None
        self._plain: list[Frame] | None = None
        self._culled: list[Frame] | None = None

    def own(self, asset: Asset | None = None, **options: Any) -> list[Image]:
        """Return images of the dedicated tier, of another asset of its method or with other settings."""
        self._check("dedicated")
        settings = options.pop("settings", {})
        frames = self._drawn(asset or self.asset, "dedicated", settings, outputs=(), **options)
        return [frame.image for frame in frames]

    def official(self) -> list[Image]:
        """Return the images as the method draws them."""
        if self._official is None:
            self._official = self.own()
        return self._official

    def mesh(self) -> Mesh:
        """Return the mesh of the standard tier."""
        self._check("standard")
        return mesh_from_asset(self.asset)

    def colored_mesh(self) -> Mesh:
        """Return the mesh of the standard tier, if it has colours or textures."""
        mesh = self.mesh()
        if mesh.vertex_colors is None and mesh.face_colors is None and not mesh.textures:
            raise DoesNotApplyError("the mesh has no colours")
        return mesh

    def plain(self) -> list[Frame]:
        """Return the frames of the standard tier as `msb render` draws it."""
        if self._plain is None:
            self._check("standard")
            self._plain = self._drawn(self.asset, "standard", {})
        return self._plain

    def of_mesh(self, mesh: Mesh, supersample: int = 1) -> list[Image]:
        """Return the images of any mesh on the standard tier."""
        return images_of(mesh, self.cameras, self.background, self.device, supersample)

    def culled(self) -> list[Frame]:
        """Return the frames of `mesh()`, drawn without its back faces."""
        if self._culled is None:
            mesh, frames = self.mesh(), []
            with contextlib.closing(_Culling(asset_from_mesh(mesh), device=self.device)) as renderer:
                for camera, front in zip(self.cameras, self._facing(mesh), strict=True):
                    renderer.show(front)
                    frames.append(renderer.render(camera.in_units(), self.background))
            self._culled = frames
        return self._culled

    @cached_property
    def light(self) -> Image:
        """How bright an engine's lamp makes each face (F,) of the asset."""
        buffers = self.asset.buffers
        light = daylight(buffers["positions"], buffers["indices"], up_axis(self.asset))
        return light.astype(np.float32)

    def _facing(self, mesh: Mesh) -> list[NDArray[np.bool_]]:
        """Return which faces each camera sees from the front."""
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        height = np.einsum("fi,fi->f", corners[:, 0], normal)
        return [normal @ camera.center > height for camera in self.cameras]

    def _check(self, tier: Tier) -> None:
        """Refuse a tier that the asset does not have, and every one where no camera sees it."""
        why = why_not(self.asset.manifest, tier) or self._blind
        if why is not None:
            raise DoesNotApplyError(why)

    def _drawn(self, asset: Asset, tier: Any, settings: Mapping[str, Any], **options: Any) -> list[Frame]:
        with Renderer(asset, tier, self.device, settings, **options) as renderer:
            return [renderer.render(camera, self.background) for camera in self.cameras]


def images_of(
    mesh: Mesh,
    cameras: Iterable[Camera],
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    device: str | None = None,
    supersample: int = 1,
) -> list[Image]:
    """Return what cameras see of any mesh on the standard tier."""
    renderer = StandardRenderer(asset_from_mesh(mesh), device=device, supersample=supersample)
    with contextlib.closing(renderer):
        return [renderer.render_image(camera.in_units(), background) for camera in cameras]


def clipped(drawn: Any) -> Image:
    """Return a frame or an image as a screen shows it."""
    return np.clip(np.asarray(getattr(drawn, "image", drawn), np.float32), 0, 1)


def squared_errors(ones: Sequence[Any], others: Sequence[Any]) -> NDArray[np.float64]:
    """Return the sum of the squared differences of the views (n, 2) in levels of 8 bits, and of how many."""
    sums = []
    for one, other in zip(ones, others, strict=True):
        levels = [to_bytes(np.asarray(getattr(drawn, "image", drawn))) for drawn in (one, other)]
        change = np.subtract(*levels, dtype=np.int32)
        # Not a product of matrices, whose threads would then spin beside the kernels.
        sums.append((np.square(change, out=change).sum(dtype=np.int64), change.size))
    return np.array(sums, np.float64)


def difference(ones: Sequence[Any], others: Sequence[Any]) -> float:
    """Return the PSNR in dB of all views at once: a mean is infinite as soon as two images are equal."""
    return decibels(squared_errors(ones, others))


def decibels(errors: NDArray[np.float64]) -> float:
    """Return the PSNR in dB of what `squared_errors` returned."""
    squares, count = errors.sum(axis=0)
    return 10 * math.log10(255**2 * count / squares) if squares else math.inf


class _Culling(StandardRenderer):
    """Draws the faces of a mesh that are to be shown."""

    def __init__(self, asset: Asset, device: str | None) -> None:
        super().__init__(asset, device=device)
        self._all, self._faces = self._triangles, len(asset.buffers["indices"])

    @in_turn
    def show(self, front: NDArray[np.bool_]) -> None:
        """Draw no other faces than `front` (F,)."""
        shown = self._scratch("shown faces", self._faces, np.uint8)
        shown.write(front.view(np.uint8))
        copies = self._scratch("shown triangles", self._all.records.shape)
        self._all.copy_some(shown, copies)
        self._triangles = replace(self._all, records=copies)
