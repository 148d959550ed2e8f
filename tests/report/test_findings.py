"""Findings: which there are, and how many. Their sentences are in golden.md."""

from pathlib import Path

import pytest

from msb.report.findings import Finding, find
from msb.report.metric_format import digits, text
from msb.report.numbers import MEAN, GapKey, Key, Numbers
from tests.report.factory import measure, numbers_of
from tests.report.test_golden import a_scene_is_missing, not_monotone


def kinds(numbers: Numbers) -> set[str]:
    return {finding.kind for finding in find(numbers)}


def test_what_is_not_monotone_has_an_excess(tmp_path: Path) -> None:
    not_monotone(tmp_path)
    numbers = numbers_of(tmp_path)
    gaps = numbers.gaps[GapKey("capture", MEAN, "two_dts", "psnr")]
    assert (gaps.monotone, gaps.triangle_excess) == (False, 4.0)
    assert "not_monotone" in kinds(numbers)
    assert "ranking" not in kinds(numbers)


def test_the_means_beside_a_gap_are_of_its_own_scenes(tmp_path: Path) -> None:
    a_scene_is_missing(tmp_path)
    numbers = numbers_of(tmp_path)
    assert numbers.value(Key("mipnerf360", MEAN, "two_dts", "dedicated", "psnr")) == 30
    gap = numbers.gaps[GapKey("mipnerf360", MEAN, "two_dts", "psnr")].port
    assert (gap.ends, gap.scenes, gap.expected) == ((20.0, 15.0), 1, 9)


@pytest.mark.parametrize("apart", [0.0, 0.004])
def test_nobody_leads_by_less_than_a_table_shows(tmp_path: Path, apart: float) -> None:
    for method, psnr, ssim in (("two_dts", 30.0, 0.8), ("mesh_splatting", 30.0 + apart, 0.9)):
        measure(tmp_path, "non_engine", psnr, ssim, method=method)
    assert "leaders" not in kinds(numbers_of(tmp_path))


def test_speed_and_structure_stay_however_much_there_is_to_say_of_quality(numbers: Numbers) -> None:
    assert len(numbers.datasets()) == 4
    many = [Finding("against", f"Number {number}.", "against") for number in range(20)]
    for first in ([], many):
        found = [one.kind for one in find(numbers, first)]
        assert {"slowdown", "structure", "training", "unsupported"} <= set(found)
        assert len(found) <= 12
        assert found.count("ranking") <= 1
    assert (found[0], len(found)) == ("against", 12)
    assert find(Numbers({})) == []


@pytest.mark.parametrize("value", [-0.04, 0.04])
def test_no_zero_has_a_sign(value: float) -> None:
    assert text("host_ms", value) == digits(value, 1, sign=True) == "0.0"
