"""The contribution of each face to the images of given cameras, computed in OpenCL.

`ReferenceFrame.contribution` (`msb.reference`) is the readable NumPy version. The NumPy version counts
samples; this module counts pixels.
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
    """Yield the contributions of all F faces to each view.

    Parameters
    ----------
    views : iterable of (Camera, picture)
        `picture` is an image of the view whose colours are summed, (H, W, 3) float32 and finite, or None.

    Yields
    ------
    (F, 4) or, without a picture, (F, 1) float64, or None
        The last column is the weight of each face in pixels. The weight of a blended face is the sum of alpha
        times transmittance. The weight of an opaque face is the number of pixels that show the face. The
        first three columns are the picture's red, green and blue, each summed with the weights of the face.
        If a renderer of another package reports no face ids, None is yielded.

    Raises
    ------
    Exception
        The errors of `msb.Renderer`.
    """
    if tier == "dedicated" and pipeline_of(asset) is SplattingPipeline:
        with closing(SplattingPipeline(asset, device=device, settings=settings, outputs=())) as pipeline:
            for camera, picture in views:
                yield pipeline.shares(camera.in_units(asset.manifest.origin), picture)
        return
    with Renderer(asset, tier, device, settings) as renderer:
        for camera, picture in views:
            faces = renderer.render(camera).face_id
            yield None if faces is None else _sum_by_face(faces, picture, asset.manifest.face_count)


def _sum_by_face(faces: NDArray[np.int32], picture: Picture | None, count: int) -> NDArray[np.float64]:
    """Return the sum of colours and the number of pixels for each face. `faces` (H, W) is -1 at the
    background."""
    seen = faces >= 0
    numbers = faces[seen]
    colors = () if picture is None else picture[seen].T
    values = (*colors, np.ones(len(numbers)))
    return np.stack([np.bincount(numbers, value, minlength=count) for value in values], axis=1)
