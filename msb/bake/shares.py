"""What each face adds to the pictures that teach: in how many pixels, and what they show there."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.asset.tiers import why_not
from msb.render import Renderer
from msb.render.dedicated import pipeline_of
from msb.render.splat.pipeline import SplattingPipeline

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.bake.lessons import Lessons
    from msb.cl import Device
    from msb.registry import Tier

_NO_COLOR = 0.5
"""What stands for the colour of a face that no picture shows."""


@dataclass(frozen=True, eq=False)
class Shares:
    """Sums over all pixels of all pictures, for F faces.

    Attributes
    ----------
    weight : (F,) float64
        In pixels: of a face that is blended the sum of alpha times transmittance, of an opaque one the number
        of pixels that show it.
    color : (F, 3) float64
        The mean of what the pictures show where the face is, weighted likewise; 0.5 where the weight is 0.
    pixels : int
        Of all pictures.
    """

    weight: NDArray[np.float64]
    color: NDArray[np.float64]
    pixels: int


def blending_shares(asset: Asset, lessons: Lessons, device: str | Device | None = None) -> Shares | None:
    """Return what each face of `asset` adds to the lessons, as its method draws it.

    The look is that of the dedicated tier, or of the standard one where the method has no look of its own.
    None if a package draws it and does not say which face a pixel shows. Raises what `msb.Renderer` raises.
    """
    tier: Tier = "standard" if why_not(asset.manifest, "dedicated") else "dedicated"
    views = enumerate(lessons.cameras)
    count = asset.manifest.face_count
    sums = np.zeros((count, 4))
    if tier == "dedicated" and pipeline_of(asset) is SplattingPipeline:
        with closing(SplattingPipeline(asset, device=device, outputs=())) as pipeline:
            for number, camera in views:
                sums += pipeline.shares(camera.in_units(), lessons.image(number))
    else:
        with Renderer(asset, tier, device) as renderer:
            for number, camera in views:
                faces = renderer.render(camera, lessons.background).face_id
                if faces is None:
                    return None
                sums += _counted(faces, lessons.image(number), count)
    weight = sums[:, 3]
    seen = weight > 0
    color = np.full((count, 3), _NO_COLOR)
    color[seen] = sums[seen, :3] / weight[seen, None]
    pixels = sum(camera.width * camera.height for camera in lessons.cameras)
    return Shares(weight, color, pixels)


def _counted(faces: NDArray[np.int32], picture: NDArray[np.float32], count: int) -> NDArray[np.float64]:
    """Return the sums (F, 4) of a view whose pixels show `faces` (H, W), -1 for none: colours and pixels."""
    seen = faces >= 0
    numbers, colors = faces[seen], picture[seen]
    values = (*colors.T, np.ones(len(numbers)))
    return np.stack([np.bincount(numbers, value, minlength=count) for value in values], axis=1)
