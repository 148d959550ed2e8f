"""95 % t intervals of averages over scenes, or over the views of a single scene.

The value of a scene is the average over its views, because the views of a scene are correlated. The interval
of n values is their average plus and minus t(0.975, n - 1) s / sqrt(n), where s is the standard deviation of
the values. The p value is computed by the one-sample t test (Student, "The probable error of a mean",
Biometrika 6, 1908). docs/protocol.md lists the rate of false positives for each sample size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.bench.records import Result
from msb.metrics.images import PSNR_CAP
from msb.metrics.registry import IMAGE_METRICS

# Significance level of the tests.
LEVEL = 0.05
# Differences are tested only if the largest number of views per scene is at most this factor times the
# smallest. If all differences are random, a correct test reports 5 % of them as significant. For a true
# difference of 0, the test reports significance in 4.2 % of cases at a ratio of 3, and in 1 % at a ratio of
# 100.
MOST_UNEQUAL = 3
NO_VIEWS = "no values of single views"
# Values with a smaller relative difference are treated as equal.
_SAME = 1e-9


@dataclass(frozen=True)
class Interval:
    """The 95 % confidence interval of an average, and its p value.

    `reason` explains a missing interval or p value.
    """

    ends: tuple[float, float] | None
    # Description of the sample: "9 scenes" or "20 views of one scene".
    over: str
    # The p value of the test that the average is 0.
    p: float | None = None
    reason: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the interval as keys of the JSON report."""
        data: dict[str, Any] = {"interval": None if self.ends is None else list(self.ends)}
        data["interval_over"] = self.over
        data |= {"p": self.p, "significant": excludes_zero(self)} if self.p is not None else {}
        return data | ({} if self.reason is None else {"interval_reason": self.reason})


def view_values(result: Result, metric: str) -> dict[str, float]:
    """Return the value of an image metric in each view of a record.

    If a view has no value, the function returns an empty result.

    An infinite PSNR counts as 100 dB, as in averages.
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
    """Return the 95 % confidence interval of an average over scenes.

    `scenes` contains, for each scene, the values of all views. A value can be a metric of one condition, or
    the difference between two conditions. A scene's value is the average over its views. If there is only one
    scene, the interval is computed from its views.
    """
    counts = [len(values) for values in scenes]
    if not counts or not all(counts):
        return Interval(None, "no views", reason=NO_VIEWS)
    single = len(counts) == 1
    values = np.asarray(scenes[0] if single else [np.mean(views) for views in scenes], float)
    single_scene = f"{counts[0]} view{'s' if counts[0] > 1 else ''} of one scene"
    over = single_scene if single else f"{len(counts)} scenes"
    if not np.isfinite(values).all():
        return Interval(None, over, reason="a value is not finite")
    if len(values) < 2:
        return Interval(None, over, reason="a single view has no spread")
    # The first value is subtracted before summing, so that equal values cause no rounding error.
    mean = float(values[0] + (values - values[0]).mean())
    error = float(np.std(values - values[0], ddof=1)) / len(values) ** 0.5
    if error <= _SAME * abs(mean):
        return Interval((mean, mean), over, reason=f"{over} give the same value, so there is no spread")
    from scipy.special import stdtr, stdtrit

    half = float(stdtrit(len(values) - 1, 1 - LEVEL / 2)) * error
    ends = mean - half, mean + half
    if not single and max(counts) > MOST_UNEQUAL * min(counts):
        text = f"the scenes have {min(counts)} to {max(counts)} views, which is too unequal for a test"
        return Interval(ends, over, reason=text)
    return Interval(ends, over, 2 * float(stdtr(len(values) - 1, -abs(mean) / error)))


def excludes_zero(difference: Interval | None) -> bool | None:
    """Return whether a difference is significant at 95 %. The result is None if the test is impossible."""
    return None if difference is None or difference.p is None else difference.p < LEVEL
