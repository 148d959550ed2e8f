"""What each face of an asset adds to the images that cameras see, by OpenCL.

The readable twin is `ReferenceFrame.contribution` (`msb.reference`), in samples where this is in pixels.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.cl import Device
from msb.registry import Tier
from msb.render.dedicated import pipeline_of
from msb.render.renderer import Renderer
from msb.render.splat.pipeline import SplattingPipeline
from msb.scenes import Camera

Picture = NDArray[np.float32]


def shares_by_view(
    asset: Asset,
    views: Iterable[tuple[Camera, Picture | None]],
    *,
    tier: Tier = "dedicated",
    settings: Mapping[str, Any] | None = None,
    device: str | Device | None = None,
) -> Iterator[NDArray[np.float64] | None]:
    """Yield what each of F faces adds to one view after the other.

    Parameters
    ----------
    views : iterable of (Camera, picture)
        What is seen there, (H, W, 3) float32, finite; or None.

    Yields
    ------
    (F, 4) or, without a picture, (F, 1) float64, or None
        Last the weight, in pixels: of a face that is blended the sum of alpha times transmittance, of an
        opaque one the number of pixels that show it. Before it the sums of the picture's colours, weighted
        likewise. None if a package draws the asset and does not say which face a pixel shows.

    Raises
    ------
    what `msb.Renderer` raises
    """
    if tier == "dedicated" and pipeline_of(asset) is SplattingPipeline:
        with closing(SplattingPipeline(asset, device=device, settings=settings, outputs=())) as pipeline:
            for camera, picture in views:
                yield pipeline.shares(camera.in_units(), picture)
        return
    with Renderer(asset, tier, device, settings) as renderer:
        for camera, picture in views:
            faces = renderer.render(camera).face_id
            yield None if faces is None else _counted(faces, picture, asset.manifest.face_count)


def _counted(faces: NDArray[np.int32], picture: Picture | None, count: int) -> NDArray[np.float64]:
    """Return the sums of a view whose pixels show `faces` (H, W), -1 for none: colours, and pixels."""
    seen = faces >= 0
    numbers = faces[seen]
    colors = () if picture is None else picture[seen].T
    values = (*colors, np.ones(len(numbers)))
    return np.stack([np.bincount(numbers, value, minlength=count) for value in values], axis=1)
