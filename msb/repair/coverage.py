"""Count the pixels that each face covers in images. These counts serve as the weights of the faces."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.tiers import refusal
from msb.errors import Unsupported
from msb.render import Renderer
from msb.scenes import Camera


def count_pixels(
    asset: Asset,
    cameras: Sequence[Camera],
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> NDArray[np.float64]:
    """Return the number of pixels (F,) that each face covers in standard-tier renderings of all cameras.

    The argument `step` is called after each camera.
    """
    if why := refusal(asset.manifest, "standard"):
        text = f"--cameras needs standard-tier renderings to count the pixels of faces; {why}"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
    pixels = np.zeros(asset.manifest.face_count)
    with Renderer(asset, tier="standard", device=device) as renderer:
        for camera in cameras:
            faces = renderer.render(camera).face_id  # face ids (H, W), -1 for the background
            if faces is not None:
                pixels += np.bincount(faces[faces >= 0], minlength=len(pixels))
            step()
    return pixels
