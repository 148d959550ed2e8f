"""How far two renderers agree, by statistics that suit rasterizers instead of a greatest difference.

Hardware snaps corners to a grid of 1/256 pixel, some software to 1/16, ray tracers not at all: along edges,
and where faces cross, pixels may show another face. Inside of faces they may not differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from msb.metrics.images import psnr_of_mse
from msb.render.frame import Frame, interior


@dataclass(frozen=True)
class Agreement:
    """How a renderer's images compare with ours; levels are steps of 1/255, of colours rounded to them.

    Attributes
    ----------
    pixels : int
    within_a_level : float
        Share of pixels of which no channel differs by more than one level.
    psnr : float
        The PSNR in decibels of the images clamped to [0, 1]; infinite if they are equal.
    covered_alike : float
        Share of pixels where both images show a face, or neither does.
    interior : int
        Number of pixels whose 3 x 3 neighbourhood shows one face in our image.
    interior_within_a_level : float
        Share of these within a level; 1 if there are none.
    interior_p999, interior_max : float
        99.9th percentile and maximum of their differences, in levels.
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
    """Return how `theirs` compares with `ours`, which has face ids, over all frames together."""
    levels, squares, alike, inner = [], [], [], []
    for one, own in zip(theirs, ours, strict=True):
        assert own.face_id is not None
        a, b = (np.clip(frame.image.astype(np.float64), 0, 1) for frame in (one, own))
        levels.append(np.abs(np.round(255 * a) - np.round(255 * b)).max(axis=2).reshape(-1))
        squares.append(((a - b) ** 2).reshape(-1))
        alike.append(((one.alpha > 0) == (own.alpha > 0)).reshape(-1))
        inner.append(interior(own.face_id).reshape(-1))
    level, square, inside = np.concatenate(levels), np.concatenate(squares), np.concatenate(inner)
    within = level[inside]
    return Agreement(
        pixels=len(level),
        within_a_level=float((level <= 1).mean()),
        psnr=psnr_of_mse(float(square.mean())),
        covered_alike=float(np.concatenate(alike).mean()),
        interior=len(within),
        interior_within_a_level=float((within <= 1).mean()) if len(within) else 1.0,
        interior_p999=float(np.percentile(within, 99.9)) if len(within) else 0.0,
        interior_max=float(within.max(initial=0)),
    )
