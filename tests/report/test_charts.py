"""The charts of the report: as SVG in pages, as PDF for LaTeX, the same bytes for the same numbers."""

import re
import xml.etree.ElementTree as ET

import pytest

from msb.report.figures import deployment_gap, differences
from msb.report.numbers import Key, Number, Numbers
from msb.report.pages import report_files
from msb.report.report import Report
from msb.report.tables.reproducibility import pairs


@pytest.mark.slow
def test_charts_are_well_formed_and_take_the_colours_of_the_page(report: Report) -> None:
    charts = [figure for section in report.sections for figure in section.figures]
    names = {figure.name for figure in charts}
    assert {"deployment_gap-tanksandtemples", "quality_speed-tanksandtemples"} <= names
    assert "reproducibility-tanksandtemples" in names
    identifiers: list[str] = []
    for figure in charts:
        root = ET.fromstring(figure.alone)
        identifiers += [value for node in root.iter() if (value := node.get("id"))]
        assert "currentColor" in figure.inline
        assert "#010203" not in figure.inline + figure.alone
        assert "<script" not in figure.svg
    assert len(identifiers) == len(set(identifiers))


@pytest.mark.slow
def test_charts_are_the_same_bytes_again(numbers: Numbers) -> None:
    first, second = (deployment_gap(numbers, "mipnerf360") for _ in range(2))
    assert first == second
    assert first.pdf() == second.pdf()


def test_models_of_one_protocol_do_not_look_alike() -> None:
    models = ["two_dts", "ab", "ba", *(f"model {number}" for number in range(6))]  # letters of one sum
    conditions = ("non_engine", "dedicated", "dedicated/global", "dedicated/none")
    values = {
        Key("mine", scene, model, condition, "psnr"): Number(20.0)
        for scene in ("pebble", "mean")
        for model in models
        for condition in conditions
    }
    figure = deployment_gap(Numbers(values), "mine")
    drawn = re.findall(r'<path d="[^"]*" clip-path="[^"]*" style="([^"]*)"', figure.svg)
    looks = {style for style in drawn if re.search(r"stroke-width: 1\.8\b", style)}
    assert len(looks) == len(models)  # a colour and a line style each
    assert [figure.svg.count(f">ab{variant}<") for variant in ("", ", global", ", none")] == [1, 1, 1]
    ticks = [float(y) for y in re.findall(r'text-anchor: end[^>]* y="([0-9.]+)"', figure.svg)]
    assert max(ticks) - min(ticks) > 72  # points: 27 names in the legend leave the chart its height


@pytest.mark.slow
def test_latex_gets_charts_as_pdf_without_date_and_type_3_fonts(report: Report) -> None:
    made = report_files(report, formats=["tex"])
    charts = [name for name in made if name.startswith("figures/")]
    assert charts == [f"figures/{one.name}.pdf" for section in report.sections for one in section.figures]
    for name in charts:
        assert made[name].startswith(b"%PDF-")
        assert not re.search(rb"/(CreationDate|Producer|Creator|Type3)\b", made[name])
        assert b"/TrueType" in made[name] or b"/CIDFontType2" in made[name]


def test_the_paper_tells_no_scenes_of_its_means() -> None:
    means = Numbers({Key("dtu", "mean", "two_dts", "non_engine", "psnr"): Number(20.0)})
    assert not means.has_other_scenes("dtu")


@pytest.mark.slow
def test_published_scenes_give_bars_per_scene(numbers: Numbers) -> None:
    scene = Key("tanksandtemples", "train", "two_dts", "non_engine", "psnr", "paper")
    found = pairs(numbers, Numbers({scene: Number(23.0)}))
    figure = differences(found, "tanksandtemples")
    assert "per scene" in figure.caption
    assert ">train<" in figure.svg
    assert differences(found, "dtu") is None
