"""Compare the scores of two assets view by view, with paired intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.metrics.images import PSNR_CAP
from msb.score.measurement import Score
from msb.score.pictures import psnr_within

_LEVEL = 0.95


@dataclass(frozen=True)
class Comparison:
    """Differences of the second asset from the first; positive is better, except for LPIPS.

    Attributes
    ----------
    first, second : str
        Paths of the assets.
    differences : dict
        Name -> mean difference over the held-out views, ends of its 95 % interval (None with fewer than two
        views), and number of views. "psnr_both" is in dB over the pixels that both assets cover.
    """

    first: str
    second: str
    differences: dict[str, dict[str, Any]]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON data."""
        return dict(vars(self))


def compare_scores(first: Score, second: Score) -> Comparison:
    """Return the paired differences of two scores on one capture; empty if one of them is unverified."""
    differences = {}
    pairs = list(zip(first.pictures, second.pictures, strict=False))
    for name in ("psnr", "ssim", "lpips"):
        values = [(getattr(a, name), getattr(b, name)) for a, b in pairs]
        if values and all(a is not None and b is not None for a, b in values):
            differences[name] = _summarize([min(b, PSNR_CAP) - min(a, PSNR_CAP) for a, b in values])
    both = []
    for a, b in pairs:
        where = a.covered & b.covered
        one, two = (psnr_within(picture.drawn, picture.view.photograph, where) for picture in (a, b))
        if one is not None and two is not None:
            both.append(min(two, PSNR_CAP) - min(one, PSNR_CAP))
    if both:
        differences["psnr_both"] = _summarize(both)
    return Comparison(first.path, second.path, differences)


def _summarize(values: list[float]) -> dict[str, Any]:
    """Return mean, 95 % t interval and number of paired differences."""
    from scipy.special import stdtrit

    array: NDArray[np.float64] = np.asarray(values, np.float64)
    mean, ends = float(array.mean()), None
    if len(array) > 1:
        half = float(stdtrit(len(array) - 1, 0.5 + _LEVEL / 2) * array.std(ddof=1) / len(array) ** 0.5)
        ends = [mean - half, mean + half]
    return {"mean": mean, "interval": ends, "views": len(array)}
