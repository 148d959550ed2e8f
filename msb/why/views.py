"""The views of one asset, drawn in the ways that causes of a worse look compare."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import daylight, normals_of, up_axis
from msb.asset.settings import effective_settings
from msb.asset.tiers import why_not
from msb.meshes.assets import mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.registry import Tier
from msb.render import Renderer
from msb.render.device_scope import in_turn
from msb.render.frame import Frame
from msb.render.standard.renderer import StandardRenderer
from msb.render.standard.supersampling import box_mean, enlarged
from msb.scenes import Camera
from msb.views import Views as ChosenViews
from msb.views import images_of

Image = NDArray[np.float32]


# dB from which on images differ by rounding alone.
EQUAL = 90.0


class DoesNotApplyError(Exception):
    """The asset cannot be drawn with this cause; the text says why."""


class _Plain(NamedTuple):
    """What the standard tier shows of an asset."""

    # As `msb render` draws it.
    frames: list[Frame]
    # Without back faces.
    culled: list[Frame]
    # With as many samples a pixel each way as the method takes itself; four if its renderer is this one.
    supersampled: list[Image]


class Views:
    """The views of one asset, drawn in its different ways; each way is drawn once.

    Attributes
    ----------
    chosen : msb.views.Views
        Those of the given views that see the asset.
    samples : mapping
        The setting by which the method's own renderer takes several samples a pixel each way, empty if none.
    """

    def __init__(
        self,
        asset: Asset,
        views: ChosenViews,
        background: tuple[float, float, float],
        device: str | None,
    ) -> None:
        self.asset, self.background, self.device = asset, background, device
        values = effective_settings(asset.manifest)
        self.samples: dict[str, int] = {}
        for name in ("supersample", "render_up_scale"):
            if isinstance(value := values.get(name), int) and value > 1:
                self.samples[name] = value
        self._standard = None if why_not(asset.manifest, "standard") else self._drawn_plain(views.cameras)
        seen = [] if self._standard is None else [(frame.alpha > 0).any() for frame in self._standard.frames]
        self.chosen = views if seen and all(seen) else views.seeing(asset, device)
        if self._standard is not None and 0 < len(self.chosen.cameras) < len(views.cameras):
            self._standard = self._drawn_plain(self.chosen.cameras)
        self.cameras = self.chosen.cameras
        self._blind = None if self.cameras else views.nothing

    def own(self, asset: Asset | None = None, **options: Any) -> list[Image]:
        """Return images of the dedicated tier, of another asset of its method or with other settings."""
        self._check("dedicated")
        settings = options.pop("settings", {})
        frames = self._drawn(asset or self.asset, "dedicated", settings, outputs=(), **options)
        return [frame.image for frame in frames]

    @cached_property
    def official(self) -> list[Image]:
        """The images as the method draws them."""
        return self.own()

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

    @property
    def plain(self) -> _Plain:
        """What the standard tier shows."""
        self._check("standard")
        assert self._standard is not None
        return self._standard

    def _drawn_plain(self, cameras: Sequence[Camera]) -> _Plain:
        """Return what the standard tier shows: one renderer draws all, since to make it takes longer."""
        is_own = why_not(self.asset.manifest, "dedicated") is not None
        samples = max(self.samples.values(), default=4 if is_own else 1)
        units = [camera.in_units() for camera in cameras]
        with contextlib.closing(_Culling(self.asset, device=self.device)) as renderer:
            frames = [renderer.render(camera, self.background) for camera in units]
            several, culled = [frame.image for frame in frames], []
            if samples > 1:
                larger = (enlarged(camera, samples) for camera in units)
                several = [box_mean(renderer.render_image(one, self.background), samples) for one in larger]
            for camera, front in zip(units, self._facing(cameras), strict=True):
                renderer.show(front)
                culled.append(renderer.render(camera, self.background))
        return _Plain(frames, culled, several)

    def of_mesh(self, mesh: Mesh) -> list[Image]:
        """Return the images of any mesh on the standard tier."""
        return images_of(mesh, self.cameras, self.background, self.device)

    @cached_property
    def light(self) -> Image:
        """How bright an engine's lamp makes each face (F,) of the asset."""
        buffers = self.asset.buffers
        light = daylight(buffers["positions"], buffers["indices"], up_axis(self.asset))
        return light.astype(np.float32)

    def _facing(self, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
        """Return which faces each camera sees from the front, (n, F)."""
        positions, indices = self.asset.buffers["positions"], self.asset.buffers["indices"]
        front = np.zeros((len(cameras), len(indices)), bool)
        for here, first, normals in normals_of(positions, indices):
            height = np.einsum("fi,fi->f", first, normals)
            front[:, here] = [normals @ camera.center > height for camera in cameras]
        return front

    def _check(self, tier: Tier) -> None:
        """Refuse a tier that the asset does not have, and every one where no camera sees it."""
        why = why_not(self.asset.manifest, tier) or self._blind
        if why is not None:
            raise DoesNotApplyError(why)

    def _drawn(self, asset: Asset, tier: Any, settings: Mapping[str, Any], **options: Any) -> list[Frame]:
        with Renderer(asset, tier, self.device, settings, **options) as renderer:
            return [renderer.render(camera, self.background) for camera in self.cameras]


def clipped(drawn: Any) -> Image:
    """Return a frame or an image as a screen shows it."""
    return np.clip(np.asarray(getattr(drawn, "image", drawn), np.float32), 0, 1)


class _Culling(StandardRenderer):
    """Draws the faces of an asset that are to be shown: all, if nothing else is said."""

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
