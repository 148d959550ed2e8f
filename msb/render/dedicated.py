"""The dedicated tier: native rendering by the image formation of the method.

The module `native` of a method has a function ``splat_model`` or a class ``Pipeline``. The splatting pipeline
can draw the result of ``splat_model`` (`msb.render.splat.model`). A ``Pipeline`` is a complete renderer
(`msb.render.backend.Backend`).
"""

from typing import Any

from msb.asset import Asset
from msb.errors import Unsupported
from msb.registry import role
from msb.render.backend import Backend, Factory


def dedicated_renderer(asset: Asset, **options: Any) -> Backend:
    """Create the native renderer of the asset's method with these options."""
    return pipeline_of(asset)(asset, **options)


def pipeline_of(asset: Asset) -> Factory:
    """Return the class that renders the asset's method natively."""
    native: Any = role(asset.manifest.method, "native")
    if native is None:
        text = f"{asset.manifest.method} on tier dedicated: its package contains no native renderer"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
    if hasattr(native, "Pipeline"):
        pipeline: Factory = native.Pipeline
        return pipeline
    from msb.render.splat.pipeline import SplattingPipeline

    return SplattingPipeline
