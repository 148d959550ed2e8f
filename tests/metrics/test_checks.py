"""The helper for tests of metrics finds what is wrong with one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msb.metrics import ImageMetric
from tests.metrics.checks import check_metric


def mae(a: Any, b: Any) -> float:
    return float(np.abs(a - b).mean())


MAE = ImageMetric(
    name="mae",
    key="mae",
    title="MAE",
    unit="1",
    decimals=4,
    better="lower",
    equal=0.0,
    measure=mae,
    parameters={},
    libraries=("numpy",),
)


def spoils(a: Any, b: Any) -> float:
    value = mae(a, b)
    a[:] = 0
    return value


def test_a_metric_that_is_right() -> None:
    check_metric(MAE, lambda a, b: sum(abs(a - b).ravel()) / a.size)


@pytest.mark.parametrize(
    "wrong",
    [
        {"measure": lambda a, b: mae(a, b) + 1},
        {"measure": lambda a, b: np.abs(a - b)},
        {"measure": spoils},
        {"equal": 1.0},
        {"better": "higher"},
        {"libraries": ("numpy", "not-there")},
    ],
)
def test_one_that_is_wrong(wrong: dict[str, Any]) -> None:
    with pytest.raises((AssertionError, ValueError)):
        check_metric(replace(MAE, **wrong), mae)
