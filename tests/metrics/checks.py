"""A test for any image metric: it checks values for several kinds of images, and the identity.

    def test_mae() -> None:
        check_metric(MAE, lambda a, b: sum(abs(a - b).ravel()) / a.size)

is a complete test. The second argument computes the metric independently: by a slow and simple formula, or
with another library.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.metrics import ImageMetric

Bytes = NDArray[np.uint8]
KINDS = ("noise", "extremes", "flat", "a level apart", "smooth")


def images(kind: str, height: int, width: int, seed: int = 0) -> tuple[Bytes, Bytes]:
    """Return two images of one of the `KINDS`."""
    random = np.random.default_rng(seed)
    a, b = random.integers(0, 256, (2, height, width, 3), dtype=np.uint8)
    if kind == "extremes":
        a, b = 255 * (a > 127).astype(np.uint8), 255 * (b > 127).astype(np.uint8)
    elif kind == "flat":  # the variances are 0, and rounding must not make variances negative
        a[:], b[:] = a[0, 0], b[0, 0]
    elif kind == "a level apart":
        b = a ^ (random.random(a.shape) < 0.01).astype(np.uint8)
    elif kind == "smooth":
        a = np.cumsum(a, axis=1).astype(np.uint8) // 9 + np.uint8(100)
        b = np.roll(a, 1, axis=0)
    return a, b


def check_metric(
    metric: ImageMetric,
    expected: Callable[[Any, Any], float],
    *,
    smallest: int = 1,
    rel: float = 1e-9,
    abs: float = 1e-10,
) -> None:
    """Compare a metric with another computation of it, and check what records and tables require.

    `smallest` is the minimum side of an image in pixels. Values may differ by `rel` (relative) or `abs`.
    """
    for kind in KINDS:
        for height, width in ((smallest, smallest), (smallest + 9, smallest + 12), (33, 50)):
            a, b = (image / 255 for image in images(kind, height, width))
            before = a.copy(), b.copy()
            value = metric.measure(a, b)
            assert isinstance(value, float)
            assert value == pytest.approx(expected(a, b), rel=rel, abs=abs), (kind, height, width)
            assert metric.measure(a, a) == metric.equal
            assert value <= metric.equal if metric.better == "higher" else value >= metric.equal
            assert math.isfinite(value) or np.array_equal(a, b), (
                "only equal images may have an infinite value"
            )
            np.testing.assert_array_equal(before, (a, b), "the metric changes its images")
    record = metric.identity().to_dict()
    assert json.loads(json.dumps(record)) == record
    assert (record["name"], record["better"], record["unit"]) == (metric.name, metric.better, metric.unit)
    assert None not in record["libraries"].values(), "a listed library is not installed"
