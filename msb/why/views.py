"""Images of one asset, rendered in all the ways that measuring the causes requires."""

import contextlib
from collections.abc import Sequence
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
from msb.render.standard.supersampling import box_mean, enlarge
from msb.scenes import Camera
from msb.views import ChosenViews, measure_coverage, render_standard

Image = NDArray[np.float32]

# PSNR in dB above which images differ only by rounding and are reported as equal.
EQUAL = 90.0
# For each native renderer, the setting for the number of samples per pixel along each axis.
_SAMPLING_SETTINGS = ("supersample", "render_up_scale")


class DoesNotApplyError(Exception):
    """Raised if a cause does not apply to the asset. The text of the error is the reason."""


class _StandardImages(NamedTuple):
    """Images of the standard-tier mesh, one for each camera."""

    # Standard-tier images as drawn by `msb render`.
    frames: list[Frame]
    # Without back faces.
    culled: list[Frame]
    # Images with the samples per pixel of the native renderer. If the method has no native renderer, an image
    # has 16 samples per pixel.
    supersampled: list[Image]


class CauseViews:
    """The cameras of an asset and its renderings. Each kind of rendering is computed at most once.

    Attributes
    ----------
    chosen : msb.views.ChosenViews
        The cameras that see the asset.
    samples : dict
        The number of samples per pixel along each axis. The key is the name of the setting in the native
        renderer. If the native renderer takes one sample per pixel, `samples` is empty.
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
        for name in _SAMPLING_SETTINGS:
            if isinstance(value := values.get(name), int) and value > 1:
                self.samples[name] = value
        # Render the standard tier first. If the asset is visible in all images, no separate visibility test
        # is needed.
        self._standard = None if why_not(asset.manifest, "standard") else self._draw_standard(views.cameras)
        frames = [] if self._standard is None else self._standard.frames
        covered = {number: share for number, frame in enumerate(frames) if (share := measure_coverage(frame))}
        is_seen = covered and len(covered) == len(views.cameras)
        self.chosen = views.with_covered(covered) if is_seen else views.without_blind(asset, device)
        if self._standard is not None and 0 < len(self.chosen.cameras) < len(views.cameras):
            self._standard = self._draw_standard(self.chosen.cameras)
        self.cameras = self.chosen.cameras
        self._no_view_reason = self.chosen.why_not

    def draw_native(self, asset: Asset | None = None, **options: Any) -> list[Image]:
        """Return native renderings of `asset`, with options of `Renderer`.

        If `asset` is None, draw the stored asset.
        """
        self._check("dedicated")
        settings = options.pop("settings", {})
        asset = asset or self.asset
        with Renderer(asset, "dedicated", self.device, settings, outputs=(), **options) as renderer:
            return [renderer.render(camera, self.background).image for camera in self.cameras]

    @cached_property
    def native(self) -> list[Image]:
        """The native renderings."""
        return self.draw_native()

    @property
    def standard(self) -> _StandardImages:
        """The images of the standard-tier mesh."""
        self._check("standard")
        assert self._standard is not None
        return self._standard

    def colored_mesh(self) -> Mesh:
        """Return the standard-tier mesh, which must have colours or textures."""
        self._check("standard")
        mesh = mesh_from_asset(self.asset)
        if mesh.vertex_colors is None and mesh.face_colors is None and not mesh.textures:
            raise DoesNotApplyError("the mesh has no colours")
        return mesh

    def draw_mesh(self, mesh: Mesh) -> list[Image]:
        """Return standard-tier images of any mesh."""
        return render_standard(mesh, self.cameras, self.background, self.device)

    @cached_property
    def light(self) -> Image:
        """The brightness (F,) of each face under an engine's light source, in [0, 1]."""
        buffers = self.asset.buffers
        light = daylight(buffers["positions"], buffers["indices"], up_axis(self.asset))
        return light.astype(np.float32)

    def _draw_standard(self, cameras: Sequence[Camera]) -> _StandardImages:
        """Return all images of the standard tier.

        One renderer draws all images, because creating a renderer is slow.
        """
        no_native = why_not(self.asset.manifest, "dedicated") is not None
        samples = max(self.samples.values(), default=4 if no_native else 1)
        units = [camera.in_units(self.asset.manifest.origin) for camera in cameras]
        with contextlib.closing(_CullingRenderer(self.asset, device=self.device)) as renderer:
            frames = [renderer.render(camera, self.background) for camera in units]
            supersampled, culled = [frame.image for frame in frames], []
            if samples > 1:
                larger = (enlarge(camera, samples) for camera in units)
                supersampled = [
                    box_mean(renderer.render_image(camera, self.background), samples) for camera in larger
                ]
            for camera, front in zip(units, self._front_faces(cameras), strict=True):
                renderer.select(front)
                culled.append(renderer.render(camera, self.background))
        return _StandardImages(frames, culled, supersampled)

    def _front_faces(self, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
        """Return a mask (cameras, F) of the faces that each camera sees from the front."""
        positions, indices = self.asset.buffers["positions"], self.asset.buffers["indices"]
        centers = [camera.relative_to(self.asset.manifest.origin).center for camera in cameras]
        front = np.zeros((len(cameras), len(indices)), bool)
        # Process the faces in blocks, with the first corner and the normal of each face, both (f, 3).
        for block, first, normals in normals_of(positions, indices):
            plane = np.einsum("fi,fi->f", first, normals)
            front[:, block] = [normals @ center > plane for center in centers]
        return front

    def _check(self, tier: Tier) -> None:
        """Raise DoesNotApplyError if the tier cannot draw the asset, or if no camera shows it."""
        reason = why_not(self.asset.manifest, tier) or self._no_view_reason
        if reason is not None:
            raise DoesNotApplyError(reason)


def clip_image(frame: Any) -> Image:
    """Return a frame or an image as an image clamped to [0, 1]."""
    return np.clip(np.asarray(getattr(frame, "image", frame), np.float32), 0, 1)


class _CullingRenderer(StandardRenderer):
    """A renderer that draws the selected faces of an asset. Until `select` is called, all faces are drawn."""

    def __init__(self, asset: Asset, device: str | None) -> None:
        super().__init__(asset, device=device)
        self._all, self._faces = self._triangles, len(asset.buffers["indices"])

    @in_turn
    def select(self, mask: NDArray[np.bool_]) -> None:
        """Draw only the faces of `mask` (F,) in the following frames."""
        # The names of the scratch buffers appear in memory reports.
        flags = self._scratch("shown faces", self._faces, np.uint8)
        flags.write(mask.view(np.uint8))
        records = self._scratch("shown triangles", self._all.records.shape)
        self._all.copy_some(flags, records)
        self._triangles = replace(self._all, records=records)
