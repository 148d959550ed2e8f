"""How sure a mean is: 95 % t intervals over scenes, or over the views where there is one scene.

A scene's value is the mean over its views, because what is special to a scene is common to its views. Of n
values the interval is the mean plus and minus t(0.975, n - 1) s / sqrt(n), and p is that of the one-sample
t test (Student, "The probable error of a mean", Biometrika 6, 1908). docs/protocol.md has how often pure
noise is called significant at each size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.bench.records import Result
from msb.metrics.images import PSNR_CAP
from msb.metrics.registry import IMAGE_METRICS

LEVEL = 0.05
# Where a scene has more times as many views as another, and scenes have no effect of their own, too little
# is significant: 4.2 % of pure noise at 3 times, 1 % at 100 times.
MOST_UNEQUAL = 3
NO_VIEWS = "no values of single views"
# Values that differ by a smaller share of their mean differ by rounding.
_SAME = 1e-9


@dataclass(frozen=True)
class Interval:
    """The 95 % interval of a mean, and what may be said of it; `reason` explains what is None."""

    ends: tuple[float, float] | None
    # What was drawn at random: "9 scenes" or "20 views of one scene".
    over: str
    # That of the test whether the mean is 0.
    p: float | None = None
    reason: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data of a number."""
        data: dict[str, Any] = {"interval": None if self.ends is None else list(self.ends)}
        data["interval_over"] = self.over
        data |= {"p": self.p, "significant": excludes_zero(self)} if self.p is not None else {}
        return data | ({} if self.reason is None else {"interval_reason": self.reason})


def view_values(result: Result, metric: str) -> dict[str, float]:
    """Return view -> value of an image metric in a record; empty where a view has none.

    A PSNR of equal images counts 100 dB, as in the mean.
    """
    if result.quality is None or metric not in IMAGE_METRICS:
        return {}
    values = {}
    for image in result.quality.images:
        value = PSNR_CAP if metric == "psnr" and image.psnr_infinite else image.values[metric]
        if value is None:
            return {}
        values[image.name] = value
    return values


def interval(scenes: Sequence[Sequence[float]]) -> Interval:
    """Return the 95 % interval of the mean over scenes of their means over views.

    `scenes` holds the values of each scene's views, or the differences of two conditions view by view.
    """
    counts = [len(values) for values in scenes]
    if not counts or not all(counts):
        return Interval(None, "no views", reason=NO_VIEWS)
    one = len(counts) == 1
    values = np.asarray(scenes[0] if one else [np.mean(views) for views in scenes], float)
    over = f"{counts[0]} view{'s' if counts[0] > 1 else ''} of one scene" if one else f"{len(counts)} scenes"
    if not np.isfinite(values).all():
        return Interval(None, over, reason="a value is not finite")
    if len(values) < 2:
        return Interval(None, over, reason="a single view has no spread")
    # Around one of the values: where all are equal there is nothing to round.
    mean = float(values[0] + (values - values[0]).mean())
    error = float(np.std(values - values[0], ddof=1)) / len(values) ** 0.5
    if error <= _SAME * abs(mean):
        return Interval((mean, mean), over, reason=f"{over} give the same value, so there is no spread")
    from scipy.special import stdtr, stdtrit

    half = float(stdtrit(len(values) - 1, 1 - LEVEL / 2)) * error
    ends = mean - half, mean + half
    if not one and max(counts) > MOST_UNEQUAL * min(counts):
        text = f"the scenes have {min(counts)} to {max(counts)} views, too unequal for a test"
        return Interval(ends, over, reason=text)
    return Interval(ends, over, 2 * float(stdtr(len(values) - 1, -abs(mean) / error)))


def excludes_zero(found: Interval | None) -> bool | None:
    """Return whether a difference is significant at 95 %; None where nothing may be said."""
    return None if found is None or found.p is None else found.p < LEVEL
