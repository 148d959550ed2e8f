"""The dedicated tier: each method's own look, chosen by what the asset's manifest declares."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from msb._version import __version__
from msb.render.protocol import check_options

if TYPE_CHECKING:
    from collections.abc import Mapping

    from msb.asset import Asset
    from msb.render.frame import Frame
    from msb.render.protocol import Backend, Drawn
    from msb.scenes import Camera

_PIPELINES = {
    "front_to_back": "msb.render.splatting:SplattingPipeline",
    "binary_z_buffer": "msb.render.lattice:LatticePipeline",
}
"""How primitives combine (manifest: compositing.kind) -> what draws them."""


class DedicatedRenderer:
    """The OpenCL renderer of the dedicated tier; parameters and errors as for `msb.render.Renderer`."""

    name = "msb-dedicated"
    version = __version__

    def __init__(
        self, asset: Asset, *, device: Any = None, settings: Mapping[str, Any] | None = None, **options: Any
    ) -> None:
        module, _, attribute = _PIPELINES[asset.manifest.compositing["kind"]].partition(":")
        pipeline = getattr(import_module(module), attribute)
        check_options(pipeline, options, asset, "tier dedicated")
        self._pipeline: Backend = pipeline(asset, device=device, settings=settings or {}, **options)

    def render(self, camera: Camera, background: tuple[float, float, float]) -> Frame:
        """Draw the asset from `camera` over `background`."""
        return self._pipeline.render(camera, background)

    def draw(self, camera: Camera, background: tuple[float, float, float]) -> Drawn:
        """Draw and wait, reading nothing back."""
        return self._pipeline.draw(camera, background)

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device."""
        return self._pipeline.memory()

    def close(self) -> None:
        """Release everything on the device."""
        self._pipeline.close()
