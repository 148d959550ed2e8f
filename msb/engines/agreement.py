"""Computes statistics of the differences between two renderers.

The largest difference of two images is not a useful measure of their agreement. Graphics hardware snaps
triangle corners to a grid of 1/256 pixel. Some software renderers snap to 1/16 pixel, and ray tracers do not
snap corners. Two correct renderers may show different faces at edges and intersections. Inside a face, away
from its edges, two renderers must agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from msb.metrics.images import psnr_of_mse
from msb.render.frame import Frame, interior


@dataclass(frozen=True)
class Agreement:
    """The differences between the images of another renderer and our images.


    Attributes
    ----------
    pixels : int
        Number of compared pixels.
    within_a_level : float
        Share of pixels whose channels all differ by at most one level.
    psnr : float
        The PSNR in decibels of the images clamped to [0, 1]; infinite if the images are equal.
    covered_alike : float
        Share of pixels where both images show a face, or both images show the background.
    interior : int
        Number of interior pixels: our image shows the same face in the whole 3 x 3 neighbourhood of the
        pixel.
    interior_within_a_level : float
        Share of interior pixels that differ by at most one level. The value is 1 if no pixel is interior.
    interior_p999, interior_max : float
        99.9th percentile and maximum of the interior pixels' differences, in levels of 1/255.
    """

    pixels: int
    within_a_level: float
    psnr: float
    covered_alike: float
    interior: int
    interior_within_a_level: float
    interior_p999: float
    interior_max: float


def agreement(theirs: Sequence[Frame], ours: Sequence[Frame]) -> Agreement:
    """Return the agreement of `theirs` with `ours` over all frames. The frames of `ours` must have face
    ids."""
    levels, squares, alike, inside = [], [], [], []
    for frame, reference in zip(theirs, ours, strict=True):
        assert reference.face_id is not None
        a, b = (np.clip(image.astype(np.float64), 0, 1) for image in (frame.image, reference.image))
        # Largest channel difference of each pixel, in levels: (H W,).
        levels.append(np.abs(np.round(255 * a) - np.round(255 * b)).max(axis=2).reshape(-1))
        squares.append(((a - b) ** 2).reshape(-1))
        alike.append(((frame.alpha > 0) == (reference.alpha > 0)).reshape(-1))
        inside.append(interior(reference.face_id).reshape(-1))
    level, square = np.concatenate(levels), np.concatenate(squares)
    inner = level[np.concatenate(inside)]
    return Agreement(
        pixels=len(level),
        within_a_level=float((level <= 1).mean()),
        psnr=psnr_of_mse(float(square.mean())),
        covered_alike=float(np.concatenate(alike).mean()),
        interior=len(inner),
        interior_within_a_level=float((inner <= 1).mean()) if len(inner) else 1.0,
        interior_p999=float(np.percentile(inner, 99.9)) if len(inner) else 0.0,
        interior_max=float(inner.max(initial=0)),
    )
