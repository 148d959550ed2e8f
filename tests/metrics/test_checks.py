"""The helper for tests of metrics finds what is wrong with one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from msb.metrics.images import PSNR
from tests.metrics.checks import check_metric
from tests.metrics.test_images import psnr_by_another as expected


def spoils(a: Any, b: Any) -> float:
    value = expected(a, b)
    a[:] = 0
    return value


@pytest.mark.parametrize(
    "wrong",
    [
        {"measure": lambda a, b: expected(a, b) + 1},
        {"measure": spoils},
        {"measure": lambda a, b: str(expected(a, b))},
        {"equal": 1.0},
        {"better": "lower"},
        {"libraries": ("numpy", "not-there")},
    ],
)
def test_a_metric_that_is_wrong_is_found(wrong: dict[str, Any]) -> None:
    with pytest.raises(AssertionError):
        check_metric(replace(PSNR, **wrong), expected)
