"""Bakes in reports: what the loss is made of, what a plain asset reaches and costs, in every place."""

from pathlib import Path

import pytest

from msb.report.build import build_report
from msb.report.numbers import MEAN, GapKey, Key, condition_order, condition_title
from msb.report.pages import report_files
from msb.report.results import read_results
from msb.report.tables.gaps import gaps_table
from tests.report.factory import measure, numbers_of, verdict_of
from tests.report.test_golden import bakes


@pytest.fixture
def root(tmp_path: Path) -> Path:
    bakes(tmp_path)
    return tmp_path


def test_bakes_stand_after_the_tiers_under_their_own_names() -> None:
    names = ["exported_mesh", "baked/b", "standard/wgpu", "non_engine", "standard"]
    order = ["non_engine", "standard", "standard/wgpu", "baked/b", "exported_mesh"]
    assert sorted(names, key=condition_order) == order
    assert condition_title("baked/ceiling") == "Baked, ceiling"


def test_gaps_go_to_a_bake_in_the_place_of_standard(root: Path) -> None:
    numbers = numbers_of(root)
    gaps = numbers.gaps[GapKey("capture", MEAN, "two_dts", "psnr", "baked/anew")]
    assert gaps.port.signed == pytest.approx(3.0)
    assert gaps.deploy.signed == pytest.approx(3.2)
    assert ("PSNR ↑", "2DTS, anew") in [row.labels for row in gaps_table(numbers, "capture").rows]


def test_the_verdict_judges_every_bake(root: Path) -> None:
    uses = verdict_of(root)
    looks = uses["A plain asset made anew, in any engine (Baked, anew)"]
    assert looks.mark == "NO"  # it loses 3.2 dB
    assert "3.20 dB" in looks.why
    assert "1,234" in uses["Editing a plain asset made anew (Baked, anew)"].why


@pytest.mark.slow
def test_every_format_and_page_has_the_parts_of_the_loss(root: Path) -> None:
    files = report_files(build_report(read_results(root)))
    for suffix in ("md", "tex", "csv", "json"):
        assert b"anew" in files[f"tables/loss_split-capture.{suffix}"]
        assert b"as shipped" in files[f"tables/bakes-capture.{suffix}"]
    assert b"Where the loss is" in files["report.md"]
    assert b"figures/loss_split-capture.svg" in files["report.md"]
    assert files["figures/loss_split-capture.pdf"].startswith(b"%PDF")
    assert b'id="loss_split-capture"' in files["index.html"]
    (page,) = [text for name, text in files.items() if name.startswith("verdict-")]
    assert b"anew" in page


def test_without_bakes_nothing_of_it_is_said(tmp_path: Path) -> None:
    for condition in ("dedicated", "standard"):
        measure(tmp_path, condition, 20.0)
    report = build_report(read_results(tmp_path))
    assert not report.numbers.splits
    assert "bakes" not in [section.name for section in report.sections]
    assert Key("capture", "desk", "two_dts", "standard", "psnr_16") not in report.numbers.values
