"""Bakes in reports: what the loss is made of, what a plain asset reaches and costs, in every place."""

from __future__ import annotations

from pathlib import Path

import pytest

from msb.bench.records import Cell
from msb.report.build import build_report
from msb.report.findings import find
from msb.report.numbers import MEAN, GapKey, Key, condition_order, condition_title
from msb.report.pages import report_files
from msb.report.results import read_results
from msb.report.tables.bakes import bakes_table, split_table
from msb.report.tables.gaps import gaps_table
from tests.report.factory import bake, measure, numbers_of, quality, verdict_of, write

DESK = Cell(dataset="capture", scene="desk", method="two_dts", condition="standard")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """2DTS on one scene: Dedicated 30 dB, Standard 18, kept 21.5, fitted 27."""
    for condition, psnr in {"non_engine": 30.2, "dedicated": 30.0, "standard": 18.0}.items():
        measure(tmp_path, condition, psnr)
    measure(tmp_path, "exported_mesh")
    for label, geometry, psnr in (("ceiling", "kept", 21.5), ("anew", "fitted", 27.0)):
        made = measure(tmp_path, "standard", psnr)
        parts = bake(label, geometry, made_of=DESK, faces=1234, seconds=12.0)
        own = quality(psnr, cell=parts["cell"])
        write(tmp_path, made.model_copy(update={**parts, "quality": own}))
    measure(tmp_path, "standard", 18.0)
    return tmp_path


def texts(table: object) -> dict[tuple[str, ...], list[str]]:
    """Return the labels of a table's rows -> what their cells print."""
    return {row.labels: [cell.text for cell in row.cells] for row in table.rows}


def test_bakes_stand_after_the_tiers_under_their_own_names() -> None:
    names = ["exported_mesh", "baked/b", "standard/wgpu", "non_engine", "standard"]
    order = ["non_engine", "standard", "standard/wgpu", "baked/b", "exported_mesh"]
    assert sorted(names, key=condition_order) == order
    assert condition_title("baked/ceiling") == "Baked, ceiling"


def test_the_table_of_the_loss_has_its_parts_and_its_bakes(root: Path) -> None:
    rows = texts(split_table(numbers_of(root), "capture"))
    assert rows["PSNR ↑", "2DTS"] == ["+12.00", "+3.50", "+5.50", "+3.00", "ceiling", "anew"]


def test_the_table_of_plain_assets_has_what_each_reaches_and_costs(root: Path) -> None:
    table = bakes_table(numbers_of(root), "capture")
    at = {column.title: place for place, column in enumerate(table.columns)}
    shipped, ceiling, anew = (
        texts(table)["2DTS", name] for name in ("as shipped", "Baked, ceiling", "Baked, anew")
    )
    assert [row[at["PSNR ↑"]] for row in (shipped, ceiling, anew)] == ["18.00", "21.50", "27.00"]
    assert anew[at["PSNR, 16 samples ↑"]] == "22.50"
    assert (shipped[at["Seconds ↓"]], anew[at["Seconds ↓"]]) == ("--", "12")
    assert anew[at["Triangles"]] == "1234"
    assert shipped[at["Verdict"]] == anew[at["Verdict"]] != "--"


def test_gaps_go_to_a_bake_in_the_place_of_standard(root: Path) -> None:
    numbers = numbers_of(root)
    gaps = numbers.gaps[GapKey("capture", MEAN, "two_dts", "psnr", "baked/anew")]
    assert gaps.port.signed == pytest.approx(3.0)
    assert gaps.deploy.signed == pytest.approx(3.2)
    assert ("PSNR ↑", "2DTS, anew") in texts(gaps_table(numbers, "capture"))


def test_a_finding_says_what_the_loss_is_made_of(root: Path) -> None:
    (found,) = [one for one in find(numbers_of(root)) if one.kind == "loss_split"]
    assert found.table == "loss_split-capture"
    assert "The 12.00 dB that 2DTS on capture loses" in found.sentence
    assert "colours 3.50, faces 5.50, blending 3.00; baking gives 75 % of it back." in found.sentence


def test_what_baking_gives_back_is_that_of_the_best_bake(root: Path) -> None:
    made = measure(root, "standard", 17.0)
    parts = bake("anew", "fitted", made_of=DESK)
    own = quality(17.0, cell=parts["cell"])
    write(root, made.model_copy(update={**parts, "quality": own}))
    measure(root, "standard", 18.0)
    (found,) = [one for one in find(numbers_of(root)) if one.kind == "loss_split"]
    assert "faces -4.50, blending 13.00; baking gives 29 % of it back." in found.sentence


def test_the_verdict_judges_every_bake(root: Path) -> None:
    uses = verdict_of(root)
    looks = uses["A plain asset made anew, in any engine (Baked, anew)"]
    assert looks.mark == "NO"  # it loses 3.2 dB
    assert "loses 3.20 dB" in looks.why
    assert "1,234 triangles" in uses["Editing a plain asset made anew (Baked, anew)"].why


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
    assert b"What the loss from Dedicated to Standard is made of." in page


def test_without_bakes_nothing_of_it_is_said(tmp_path: Path) -> None:
    for condition in ("dedicated", "standard"):
        measure(tmp_path, condition, 20.0)
    report = build_report(read_results(tmp_path))
    assert not report.numbers.splits
    assert "bakes" not in [section.name for section in report.sections]
    assert Key("capture", "desk", "two_dts", "standard", "psnr_16") not in report.numbers.values
