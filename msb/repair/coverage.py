"""How much of an image each face covers: what debris is to the viewer."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.tiers import refusal
from msb.errors import Unsupported
from msb.render import Renderer
from msb.scenes import Camera


def seen_pixels(
    asset: Asset,
    cameras: Sequence[Camera],
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> NDArray[np.float64]:
    """Return the number of pixels (F,) that each face covers on the standard tier, over all cameras."""
    if why := refusal(asset.manifest, "standard"):
        text = f"faces are weighted by what the standard tier shows; {why}"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
    pixels = np.zeros(asset.manifest.face_count)
    with Renderer(asset, tier="standard", device=device) as renderer:
        for camera in cameras:
            seen = renderer.render(camera).face_id
            if seen is not None:
                pixels += np.bincount(seen[seen >= 0], minlength=len(pixels))
            step()
    return pixels
