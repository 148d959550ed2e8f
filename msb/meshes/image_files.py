"""Textures as image files."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from msb.asset.texture import Sampler
    from msb.meshes.formats import Picture

_OPTIONS: dict[Picture, dict[str, Any]] = {
    "png": {},
    "jpeg": {"quality": 95, "subsampling": 0},
    "webp": {"quality": 90, "method": 6, "exact": True},
}
"""How little is lost: what it costs in bytes is less than what blocks and bled colours cost in dB."""


ENDINGS: dict[Picture, str] = {"png": ".png", "jpeg": ".jpg", "webp": ".webp"}


def packed(image: NDArray[np.uint8], kind: Picture, sampler: Sampler) -> tuple[bytes, Picture]:
    """Return an image file of `image` (H, W, 3 | 4), and its kind: PNG where JPEG would lose alpha.

    PNG keeps all of an image; WebP keeps alpha only where the sampler looks at it.
    """
    from PIL import Image

    seen = image.shape[-1] == 4 and sampler.alpha_cutoff is not None
    if seen and kind == "jpeg":
        kind = "png"
    if not seen and kind != "png":
        image = image[..., :3]
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, kind, **_OPTIONS[kind])
    return file.getvalue(), kind
