"""The dedicated tier: each method's own look.

A method's module `look` has either ``splat_model``, which the splatting pipeline draws
(`msb.render.splat.model`), or ``Pipeline``, a renderer of its own (`msb.render.backend.Backend`).
"""

from typing import Any

from msb.asset import Asset
from msb.errors import Unsupported
from msb.registry import role
from msb.render.backend import Backend, Factory


def dedicated_renderer(asset: Asset, **options: Any) -> Backend:
    """Return the renderer of the asset's method, made with these options."""
    return pipeline_of(asset)(asset, **options)


def pipeline_of(asset: Asset) -> Factory:
    """Return the class that draws the asset's method."""
    look: Any = role(asset.manifest.method, "look")
    if look is None:
        text = f"{asset.manifest.method} on tier dedicated: its package brings nothing that draws it"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
    if hasattr(look, "Pipeline"):
        own: Factory = look.Pipeline
        return own
    from msb.render.splat.pipeline import SplattingPipeline

    return SplattingPipeline
