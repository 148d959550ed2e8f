"""The means beside a gap, in a sentence and in the chart, where a scene is missing on one side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.axes import Axes

from msb.report.figures import deployment_gap
from msb.report.findings import find
from msb.report.metric_format import digits, text
from msb.report.numbers import MEAN, Key, Numbers
from msb.report.tables.gaps import gaps_table
from tests.report.factory import measure, numbers_of


@pytest.fixture
def gap_with_a_scene_missing(tmp_path: Path) -> Numbers:
    """20 and 40 dB under one condition, 15 dB and a failure on the next."""
    here: dict[str, Any] = {"dataset": "mipnerf360", "scene": "garden"}
    measure(tmp_path, "dedicated", 20.0, **here)
    measure(tmp_path, "standard", 15.0, shifts=(-0.4, 0.0, 0.4), **here)
    there = {**here, "scene": "bonsai"}
    measure(tmp_path, "dedicated", 40.0, **there)
    measure(tmp_path, "standard", **there, status="failed", quality=None, timing=None)
    return numbers_of(tmp_path)


def test_the_means_beside_a_gap_are_of_its_own_scenes(gap_with_a_scene_missing: Numbers) -> None:
    assert gap_with_a_scene_missing.value(Key("mipnerf360", MEAN, "two_dts", "dedicated", "psnr")) == 30
    said = [one.sentence for one in find(gap_with_a_scene_missing) if one.kind == "port_gap"]
    assert said == [
        "Dedicated to Standard costs 2DTS on Mip-NeRF 360 5.00 dB (20.00 to 15.00, over 1 of 9 scenes), "
        "significant at 95 % (t interval over 3 views of one scene)."
    ]


def test_the_chart_of_gaps_joins_means_of_the_same_scenes(
    gap_with_a_scene_missing: Numbers, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    plot = Axes.plot
    monkeypatch.setattr(
        Axes, "plot", lambda self, *data, **style: (drawn.append(data), plot(self, *data, **style))[1]
    )
    figure = deployment_gap(gap_with_a_scene_missing, "mipnerf360")
    assert figure.svg
    assert drawn == [((1, 2), (20.0, 15.0))]


def test_what_rounds_to_nothing_has_no_sign_and_is_monotone(tmp_path: Path) -> None:
    for condition, psnr in (("non_engine", 30.0), ("dedicated", 30.004), ("standard", 20.0)):
        measure(tmp_path, condition, psnr)
    numbers = numbers_of(tmp_path)
    cells = gaps_table(numbers, "capture").rows[0].cells
    assert [cell.text for cell in cells[:8]] == [
        "0.00", "10.00", "10.00", "0.00", "+10.00", "+10.00", "yes", "0.00",
    ]  # fmt: skip
    assert "not_monotone" not in [one.kind for one in find(numbers)]


@pytest.mark.parametrize("value", [-0.04, 0.04])
def test_no_zero_has_a_sign(value: float) -> None:
    assert text("host_ms", value) == digits(value, 1, sign=True) == "0.0"
