"""The dedicated tier: each method's own look.

A method's module `look` has either ``splat_model``, which the splatting pipeline draws
(`msb.render.splat.model`), or ``Pipeline``, a renderer of its own (`msb.render.backend.Backend`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from msb._version import __version__
from msb.errors import Unsupported
from msb.registry import role
from msb.render.backend import check_options, groups_of

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.render.backend import Backend, Drawn, Factory
    from msb.render.frame import Frame
    from msb.scenes import Camera


class DedicatedRenderer:
    """The OpenCL renderer of the dedicated tier; parameters and errors as for `msb.render.Renderer`."""

    name = "msb-dedicated"
    version = __version__

    def __init__(
        self, asset: Asset, *, device: Any = None, settings: Mapping[str, Any] | None = None, **options: Any
    ) -> None:
        pipeline = _pipeline(asset)
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

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> group, for the uses that `memory` names."""
        return groups_of(self._pipeline)

    def close(self) -> None:
        """Release everything on the device."""
        self._pipeline.close()


def _pipeline(asset: Asset) -> Factory:
    """Return what draws the asset's method."""
    look: Any = role(asset.manifest.method, "look")
    if look is None:
        text = f"{asset.manifest.method} on tier dedicated: its package brings nothing that draws it"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.path, value="dedicated")
    if hasattr(look, "Pipeline"):
        own: Factory = look.Pipeline
        return own
    from msb.render.splat.pipeline import SplattingPipeline

    return SplattingPipeline
