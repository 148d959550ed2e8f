"""How sure a mean over test views is: 95 % bootstrap intervals, over views and then over scenes.

Scenes and, within each, views are drawn with replacement (Efron and Tibshirani, "An Introduction to the
Bootstrap", 1993, chapters 8 and 13); the interval is from the 2.5th to the 97.5th percentile of the means so
drawn. The seed is fixed, so the same records give the same interval.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from msb.metrics.images import PSNR_CAP
from msb.metrics.registry import IMAGE_METRICS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from msb.bench.records import Result

    Interval = tuple[float, float]

DRAWS = 2000
_PERCENTILES = 2.5, 97.5
_SEED = 95
_MOST_VIEWS = 500
"""Views of a scene that are drawn one by one; the mean of more is as good as normally distributed."""
ONE_VIEW = "one view has no spread"


def view_values(result: Result, metric: str) -> dict[str, float]:
    """Return view -> value of an image metric in a record; empty where a view has none.

    A PSNR of equal images counts 100 dB, as in the mean.
    """
    if result.quality is None or metric not in IMAGE_METRICS:
        return {}
    found = {}
    for image in result.quality.images:
        value = PSNR_CAP if metric == "psnr" and image.psnr_infinite else image.values[metric]
        if value is None:
            return {}
        found[image.name] = value
    return found


def interval(scenes: Sequence[Sequence[float]]) -> Interval | None:
    """Return the 95 % interval of the mean over scenes of their means over views.

    Parameters
    ----------
    scenes : sequence of sequence of float
        The values of each scene's views, or the differences of two conditions' values view by view.

    Returns
    -------
    (float, float) or None
        None where there is one view in all.
    """
    if sum(map(len, scenes)) < 2 or not all(map(len, scenes)):
        return None
    # Around one of the values: where all are equal there is nothing to round.
    middle = scenes[0][0]
    means = sum(
        _share_of_scene(np.asarray(values, float) - middle, place, len(scenes))
        for place, values in enumerate(scenes)
    )
    low, high = middle + np.percentile(means, _PERCENTILES)
    return float(low), float(high)


def excludes_zero(found: Interval | None) -> bool | None:
    """Return whether a difference with this interval is significant at 95 %; None without an interval."""
    return None if found is None else not found[0] <= 0 <= found[1]


def _share_of_scene(values: NDArray[np.float64], place: int, scenes: int) -> NDArray[np.float64]:
    """Return what a scene with these views' values adds to each drawn mean over the scenes, (DRAWS,)."""
    count = len(values)
    if count <= _MOST_VIEWS:
        return np.asarray(_weights(count, place, scenes) @ values)
    times = _times(scenes)[:, place]
    random = np.random.default_rng((_SEED, scenes, place, count))
    noise = random.normal(0, values.std() / count**0.5, DRAWS)
    return np.asarray((times * values.mean() + np.sqrt(times) * noise) / scenes)


@lru_cache(maxsize=64)
def _weights(count: int, place: int, scenes: int) -> NDArray[np.float64]:
    """Return the weights of a scene's views in the drawn means, (DRAWS, count)."""
    random = np.random.default_rng((_SEED, scenes, place, count))
    # To draw as many views as there are, k times, is to draw k times as many.
    drawn = random.multinomial(_times(scenes)[:, place] * count, np.full(count, 1 / count))
    return np.asarray(drawn / (count * scenes))


@lru_cache(maxsize=64)
def _times(scenes: int) -> NDArray[np.int64]:
    """Return how often each scene is drawn, (DRAWS, scenes)."""
    random = np.random.default_rng((_SEED, scenes))
    return np.asarray(random.multinomial(scenes, np.full(scenes, 1 / scenes), DRAWS))
