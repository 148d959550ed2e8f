"""Bootstrap intervals of means over views: against a slow twin, and where they must be exact or nothing."""

from __future__ import annotations

import numpy as np
import pytest

from msb.bench.intervals import excludes_zero, interval


def slow_interval(scenes: list[list[float]], draws: int = 4000) -> tuple[float, float]:
    """Draw scenes, and anew for each of them its views, one by one."""
    random = np.random.default_rng(1)
    means = []
    for _ in range(draws):
        chosen = random.integers(len(scenes), size=len(scenes)) if len(scenes) > 1 else [0]
        own = [scenes[number] for number in chosen]
        means.append(np.mean([np.mean(random.choice(values, len(values))) for values in own]))
    low, high = np.percentile(means, (2.5, 97.5))
    return float(low), float(high)


@pytest.mark.parametrize("shape", [(25,), (2,), (9, 25, 7), (3, 3), (1, 1, 1, 1), (600,), (600, 30)])
def test_is_that_of_a_slow_twin(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(7)
    scenes = [list(random.normal(25 + 3 * random.normal(), 2, count)) for count in shape]
    found, wanted = interval(scenes), slow_interval(scenes)
    assert found is not None
    width = wanted[1] - wanted[0]
    assert found == pytest.approx(wanted, abs=0.15 * width)
    assert found == interval(scenes), "the seed is fixed"
    assert found[0] <= np.mean([np.mean(values) for values in scenes]) <= found[1]


def test_one_view_has_no_interval_and_equal_views_have_none_to_speak_of() -> None:
    assert interval([[3.0]]) is None
    assert interval([]) is None
    assert interval([[], [1.0, 2.0]]) is None
    assert interval([[0.1] * 9]) == (0.1, 0.1)


def test_a_difference_is_significant_where_its_interval_leaves_out_zero() -> None:
    assert excludes_zero((0.1, 0.2)) is True
    assert excludes_zero((-0.2, -0.1)) is True
    assert excludes_zero((-0.1, 0.2)) is False
    assert excludes_zero((0.0, 0.0)) is False
    assert excludes_zero(None) is None
