"""The views of one asset, drawn in the ways that causes of a worse look compare."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msb.asset.tiers import why_not
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.render import Renderer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.meshes import Mesh
    from msb.render import Frame
    from msb.scenes import Camera

    Image = NDArray[np.float32]


class DoesNotApplyError(Exception):
    """The asset cannot be drawn with this cause; the text says why."""


class Views:
    """The views of one asset, drawn in its different ways; each way is drawn once."""

    def __init__(
        self,
        asset: Asset,
        cameras: Sequence[Camera],
        background: tuple[float, float, float],
        settings: Mapping[str, Any],
        device: str | None,
    ) -> None:
        self.asset, self.cameras, self.background = asset, cameras, background
        self.settings, self.device = settings, device
        self._official: list[Image] | None = None
        self._plain: list[Frame] | None = None

    def own(self, asset: Asset | None = None, **options: Any) -> list[Image]:
        """Return images of the dedicated tier; `settings` among the options are added to those given."""
        why = why_not(self.asset.manifest, "dedicated")
        if why is not None:
            raise DoesNotApplyError(why)
        settings = {**self.settings, **options.pop("settings", {})}
        frames = self._drawn(asset or self.asset, "dedicated", settings, outputs=(), **options)
        return [frame.image for frame in frames]

    def official(self) -> list[Image]:
        """Return the images as the method draws them."""
        if self._official is None:
            self._official = self.own()
        return self._official

    def mesh(self) -> Mesh:
        """Return the mesh of the standard tier."""
        why = why_not(self.asset.manifest, "standard")
        if why is not None:
            raise DoesNotApplyError(why)
        return mesh_from_asset(self.asset)

    def colored_mesh(self) -> Mesh:
        """Return the mesh of the standard tier, if it has colours."""
        mesh = self.mesh()
        if mesh.vertex_colors is None and mesh.face_colors is None:
            raise DoesNotApplyError("the mesh has no colours")
        return mesh

    def plain(self) -> list[Frame]:
        """Return the frames of the standard tier as `msb render` draws it."""
        if self._plain is None:
            self._plain = self.of_mesh(self.mesh())
        return self._plain

    def of_mesh(self, mesh: Mesh, **settings: Any) -> list[Frame]:
        """Return the frames of any mesh on the standard tier."""
        return self._drawn(asset_from_mesh(mesh), "standard", settings)

    def _drawn(self, asset: Asset, tier: Any, settings: Mapping[str, Any], **options: Any) -> list[Frame]:
        with Renderer(asset, tier, self.device, settings, **options) as renderer:
            return [renderer.render(camera, self.background) for camera in self.cameras]
