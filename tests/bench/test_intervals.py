"""t intervals of means: the promise of 95 %, scipy's test as a twin, and where nothing may be said."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from msb.bench.intervals import excludes_zero, interval

MIPNERF360 = [25, 24, 30, 35, 37, 39, 16, 22, 18]


@pytest.mark.parametrize(
    ("views", "effect", "noise"),
    [
        *(([count], 0, 1) for count in (2, 3, 5, 20, 200)),
        *(([10] * count, 1, 0.3) for count in (2, 3, 5, 9)),
        ([10, 10], 0, 1),
        ([100, 200], 0.1, 1),
        (MIPNERF360, 0, 1),
        (MIPNERF360, 0.3, 1),
    ],
)
def test_pure_noise_is_called_significant_in_four_to_six_and_a_half_percent(
    views: list[int], effect: float, noise: float
) -> None:
    random = np.random.default_rng(len(views))
    said = [
        excludes_zero(interval([random.normal(effect * random.normal(), noise, count) for count in views]))
        for _ in range(3000)
    ]
    assert 0.04 <= np.mean(np.array(said, float)) <= 0.065


@pytest.mark.parametrize("shape", [(25,), (2,), (9, 25, 7), (3, 3), (1, 1, 1, 1), (600,), (600, 300)])
def test_is_that_of_scipys_test(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(7)
    scenes = [list(random.normal(0.4 + random.normal(), 2, count)) for count in shape]
    found = interval(scenes)
    wanted = ttest_1samp(scenes[0] if len(shape) == 1 else [np.mean(views) for views in scenes], 0)
    ends = wanted.confidence_interval(0.95)
    assert found.ends == pytest.approx((ends.low, ends.high), rel=1e-12)
    if found.reason is None:
        assert found.p == pytest.approx(wanted.pvalue, rel=1e-12)
        assert excludes_zero(found) is bool(wanted.pvalue < 0.05) is not (ends.low <= 0 <= ends.high)


def test_it_says_what_was_drawn_at_random() -> None:
    assert interval([[1.0, 2.0, 4.0]]).over == "3 views of one scene"
    assert interval([[1.0, 2.0], [4.0, 5.0]]).over == "2 scenes"


@pytest.mark.parametrize(
    ("scenes", "ends", "reason"),
    [
        ([], None, "no values of single views"),
        ([[], [1.0, 2.0]], None, "no values of single views"),
        ([[3.0]], None, "one view has no spread"),
        ([[1.0, float("nan")]], None, "a value is not finite"),
        ([[1.0, float("inf")], [1.0, 2.0]], None, "a value is not finite"),
        ([[0.1] * 9], (0.1, 0.1), "9 views of one scene give one and the same value, which has no spread"),
        ([[0.0] * 3], (0.0, 0.0), "3 views of one scene give one and the same value, which has no spread"),
        ([[20.3 - 20.0, 30.3 - 30.0]], (0.3, 0.3), "2 views of one scene give one and the same value"),
        ([[0.0, 100.0], [50.0]], (50.0, 50.0), "2 scenes give one and the same value, which has no spread"),
        ([[1.0, 2.0], [5.0] * 7], (-18.986, 25.486), "the scenes have 2 to 7 views, too unequal for a test"),
    ],
)
def test_where_nothing_may_be_said_it_says_why(
    scenes: list[list[float]], ends: tuple[float, float] | None, reason: str
) -> None:
    found = interval(scenes)
    assert found.ends == (None if ends is None else pytest.approx(ends, abs=1e-3))
    assert str(found.reason).startswith(reason)
    assert found.p is None
    assert excludes_zero(found) is None
    assert excludes_zero(None) is None
