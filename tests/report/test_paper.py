"""Our builders reproduce all cells of the paper's tables, and the registry agrees with its feature tables."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any, get_args

import pytest

from msb.bench.aggregate import METRICS, SCENES, mean_over, scene_groups
from msb.errors import InputError
from msb.registry import METHODS, PASSES, TIERS, Method
from msb.report.build import EQUIVALENTS, paper_report
from msb.report.layout import number_cell
from msb.report.metric_format import metric_title
from msb.report.numbers import MEAN, GapKey, Key, condition_title, dataset_title, scene_title
from msb.report.paper import (
    ENGINE_RENDERING,
    PAPER_TABLES,
    PUBLISHED_LPIPS,
    Source,
    contradictions,
    paper_numbers,
    published_numbers,
)
from msb.report.table import Table, TableCell
from msb.report.tables.reproducibility import SOURCES
from msb.report.writers import to_latex
from tests.cli.conftest import Here
from tests.conftest import ROOT

FOLDER = ROOT / "msb" / "report" / "paper_tables"
OURS = {method.paper_name: name for name, method in METHODS.items()}
NAMES = {
    "gpu_ms_p50": "p50_ms",
    "gpu_ms_p95": "p95_ms",
    "vram": "memory",
    "train_peak_mem": "train_memory",
    "train_time": "train_seconds",
    "v_over_f": "vf_ratio",
    "valence": "mean_valence",
}


def raw_cells(label: str) -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads((FOLDER / f"{label}.json").read_text())["cells"]
    return cells


@cache
def paper_tables() -> dict[str, Table]:
    """Return the tables of `msb report --paper`."""
    return paper_report(pictures=False).tables


def title_of(cell: dict[str, Any]) -> str:
    return METHODS[OURS[cell["method"]]].title


class Lookup:
    """The cells of a table by the texts of their row and column."""

    def __init__(self, table: Table) -> None:
        self.cells: dict[frozenset[str], TableCell] = {}
        for row in table.rows:
            for column, cell in zip(table.columns, row.cells, strict=True):
                words = frozenset((*row.labels, column.title, *column.groups))
                assert words not in self.cells
                self.cells[words] = cell

    def find(self, *words: str) -> TableCell:
        (cell,) = [cell for key, cell in self.cells.items() if set(words) <= key]
        return cell


def words_of(label: str, cell: dict[str, Any]) -> list[str]:
    """Return the texts of the row and of the column of our table that correspond to a cell of the paper."""
    metric = NAMES.get(cell["metric"], cell["metric"])
    condition, scene = condition_title(cell["condition"]), scene_title(cell["scene"])
    on, method, name = dataset_title(cell["dataset"]), title_of(cell), METRICS[metric].title
    return {
        "mip360_renderer_comparison": [condition, method, metric_title(metric)],
        "tnt_renderer_comparison": [condition, method, scene, metric_title(metric)],
        "tnt_unity_runtime_resources": [condition, method, scene, "Render" if metric == "memory" else name],
        "mip360_unity_gpu_latency": [f"{condition} (ms ↓)", method, scene, name],
        "mip360_unity_memory": [f"{condition} (MiB ↓)", method, scene],
        "mesh_connectivity": [scene, metric_title(metric)],
        "reproducibility_comparison": [on, method, SOURCES.get(cell.get("source"), ""), metric_title(metric)],
    }.get(label, [on, method, metric_title(metric)])


@pytest.mark.parametrize("label", [*PAPER_TABLES, "method_attributes", "feature_mapping"])
def test_numbers_equal_those_of_the_independent_transcription(shared: Path, label: str) -> None:
    golden = shared / "golden" / "paper_tables" / f"{label}.json"
    assert json.loads(golden.read_text())["cells"] == raw_cells(label)


@pytest.mark.parametrize("label", PAPER_TABLES)
def test_every_cell_is_printed_as_in_the_paper(label: str) -> None:
    table = paper_tables()[label]
    lookup, cells = Lookup(table), raw_cells(label)
    metrics = {NAMES.get(cell["metric"], cell["metric"]) for cell in cells}
    assert sum(cell.metric in metrics for cell in lookup.cells.values()) == len(cells)
    for cell in cells:
        ours = lookup.find(*words_of(label, cell))
        raw = cell["raw"] + (" M" if cell["unit"] == "1e6" else "")
        assert ours.text == raw, cell
        # The paper prints all single values bold except this one.
        exception = (label, cell["method"], cell["metric"]) == ("mip360_renderer_comparison", "3dgs", "fps")
        assert ours.bold is (cell["bold"] != (exception and cell["value"] is not None)), cell
        if cell["value"] is not None:
            assert ours.value == pytest.approx(
                cell["value"] * float((cell["unit"] == "1e6" and 1e6) or 1), rel=1e-12
            )


def numbers_in(latex: str) -> list[str]:
    """Return all numbers between the first and the last rule of a LaTeX table, without layout and names."""
    body = latex.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
    layout = (
        r"\\(?:multirow|multicolumn)\{\d+\}|\\cmidrule\S*|\\addlinespace\[.*?\]|\\ding\{\d+\}"
        r"|\\textsuperscript\{.*?\}|\\citep\{.*?\}|Mip-NeRF[~ ]360|2DTS"
    )
    return re.findall(r"\d+(?:\.\d+)?", re.sub(layout, "", body))


@pytest.mark.parametrize("label", PAPER_TABLES)
def test_numbers_stand_in_the_papers_order(shared: Path, label: str) -> None:
    source = (shared / "paper" / "meshsplatbench.tex").read_text()
    floats = re.findall(r"\\begin\{table\*?\}.*?\\end\{table\*?\}", source, re.DOTALL)
    (published,) = [table for table in floats if rf"\label{{tab:{label}}}" in table]
    ours = numbers_in(to_latex(paper_tables()[label]))
    assert len(ours) >= 50
    assert ours == numbers_in(published)


@pytest.mark.parametrize("label", ["method_attributes", "feature_mapping"])
def test_feature_matrices_are_the_papers(label: str) -> None:
    lookup, cells = Lookup(paper_tables()[label]), raw_cells(label)
    methods = {title_of(cell) for cell in cells}
    assert len(lookup.cells) == len(cells)  # no other method has a row
    assert methods == {row.labels[0] for row in paper_tables()[label].rows}
    tiers = {"standard": "Standard deployment", "dedicated": "Dedicated deployment"}
    for cell in cells:
        words = {"sh": "SH", "view_dependence": "View-dep."}
        attribute = words.get(cell["attribute"], cell["attribute"].replace("_", " ").capitalize())
        tier = [tiers[cell["condition"]]] if "condition" in cell else []
        assert lookup.find(title_of(cell), attribute, *tier).text == cell["raw"], cell


def test_the_documentation_maps_every_table_and_figure_of_the_paper(shared: Path) -> None:
    page = (ROOT / "docs" / "paper.md").read_text()
    source = (shared / "paper" / "meshsplatbench.tex").read_text()
    labels = {label: kind for kind, label in re.findall(r"\\label\{(tab|fig):(\w+)\}", source)}
    assert len(labels) == 17
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert {label for row in rows for label in re.findall(r"`(\w+)`", row.split("|")[1])} == set(labels)
    for label, kind in labels.items():  # a label of a table selects it
        assert kind == "fig" or label in EQUIVALENTS or label in paper_tables()


@pytest.mark.parametrize("label", PAPER_TABLES)
def test_means_follow_from_the_rows_within_rounding(label: str) -> None:
    values = paper_numbers(label).values
    checked = 0
    for key, number in values.items():
        scenes = {**scene_groups(key.dataset), MEAN: SCENES[key.dataset]}.get(key.scene, ())
        rows = {scene: values[of].value for scene in scenes if (of := key._replace(scene=scene)) in values}
        if rows and number.value is not None:
            metric, mean = METRICS[key.metric], mean_over(rows, scenes)
            assert not mean.partial, key
            scale = 1e6 if key.metric == "components" else metric.scale
            # The mean and each of its rows have an error of up to half a unit of the last digit.
            assert abs(mean.value - number.value) <= 10**-metric.decimals * scale * (1 + 1e-9), key
            checked += 1
    expected = {"tnt_renderer_comparison": 28, "tnt_unity_runtime_resources": 28, "mip360_unity_memory": 21,
                "mip360_unity_gpu_latency": 42, "mesh_connectivity": 8}  # fmt: skip
    assert checked == expected.get(label, 0)


GAP_NAMES = ("Adapt", "Port", "Deploy")
GAPS = [
    ("mipnerf360", "two_dts", 4.88, 10.76, 15.64),
    ("mipnerf360", "triangle_splatting", 4.17, 8.19, 12.36),
    ("mipnerf360", "mesh_splatting", 2.20, 2.69, 4.89),
    ("mipnerf360", "diffsoup", 0.39, None, None),
    ("mipnerf360", "two_dgs", None, None, 17.91),
    ("tanksandtemples", "two_dts", 4.16, 6.86, 11.02),
    ("tanksandtemples", "triangle_splatting", 3.54, 8.46, 12.00),
    ("tanksandtemples", "mesh_splatting", 4.44, 1.71, 6.15),
    ("tanksandtemples", "diffsoup", 0.43, None, None),
]


@pytest.mark.parametrize(("dataset", "method", "adapt", "port", "deploy"), GAPS)
def test_gaps_are_computed_from_the_papers_means(
    dataset: str, method: str, adapt: float | None, port: float | None, deploy: float | None
) -> None:
    gaps = paper_numbers().gaps[GapKey(dataset, MEAN, method, "psnr")]
    values = [gap.value for gap in (gaps.adapt, gaps.port, gaps.deploy)]
    assert values == [None if v is None else pytest.approx(v, abs=1e-9) for v in (adapt, port, deploy)]
    table = Lookup(paper_tables()[f"gaps-{dataset}"])
    for column, sign in (("Gap", ""), ("Loss, signed", "+")):
        cells = [table.find("PSNR ↑", METHODS[method].title, column, name) for name in GAP_NAMES]
        expected = ["N/A" if value is None else f"{sign}{value:.2f}" for value in (adapt, port, deploy)]
        assert [cell.text for cell in cells] == expected


def test_both_published_results_of_diffsoup_are_kept() -> None:
    numbers = paper_numbers()
    key = Key("tanksandtemples", MEAN, "diffsoup", "non_engine", "psnr")
    assert numbers.value(key) == 17.45
    assert numbers.value(key._replace(source="meshsplatbench")) == 18.90
    assert "18.90" in numbers.number(key).notes[0]


def test_numbers_that_cannot_be_compared_have_notes() -> None:
    numbers = paper_numbers()
    dedicated = Key("mipnerf360", MEAN, "two_dts", "dedicated", "psnr")
    assert numbers.number(dedicated).notes == (ENGINE_RENDERING,)
    assert ENGINE_RENDERING not in numbers.number(dedicated._replace(condition="standard")).notes
    lpips = Key("mipnerf360", MEAN, "diffsoup", "non_engine", "lpips", "paper")
    assert numbers.number(lpips).notes == (PUBLISHED_LPIPS,)
    assert numbers.number(lpips._replace(source="meshsplatbench")).notes == ()
    assert numbers.number(lpips._replace(dataset="tanksandtemples")).value is None
    memory = numbers.number(Key("mipnerf360", "garden", "two_dts", "standard", "memory"))
    gaussians = numbers.number(Key("mipnerf360", MEAN, "three_dgs", "non_engine", "lpips"))
    assert all("not comparable" in number.notes[0] for number in (memory, gaussians))
    assert number_cell("lpips", gaussians).footnotes == gaussians.notes


def test_published_numbers_are_read_and_validated(tmp_path: Path) -> None:
    cell = {"dataset": "mipnerf360", "scene": "garden", "method": "2dts", "condition": "non_engine",
            "metric": "psnr", "value": 27.5, "unit": "dB"}  # fmt: skip
    path = tmp_path / "published.json"
    path.write_text(json.dumps({"schema": "msb-paper-table/1", "cells": [cell]}))
    (key,) = published_numbers(path)
    assert key == Key("mipnerf360", "garden", "two_dts", "non_engine", "psnr", "paper")
    path.write_text(json.dumps({"schema": "msb-paper-table/1", "cells": [{**cell, "value": "27.5"}]}))
    with pytest.raises(InputError, match="/cells/0/value"):
        published_numbers(path)
    path.write_text(json.dumps({"schema": "msb-paper-table/1", "cells": [{**cell, "source": "a blog"}]}))
    with pytest.raises(InputError, match="/cells/0/source"):
        published_numbers(path)
    assert set(get_args(Source)) == SOURCES.keys()


def test_contradictions_are_noted_below_their_tables() -> None:
    assert contradictions().keys() <= paper_tables().keys()
    for label, notes in contradictions().items():
        assert set(notes) <= set(paper_tables()[label].notes)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_supported_tiers_have_passes(method: Method) -> None:
    for tier in TIERS:
        assert (tier in method.passes) is method.supports(tier)
        assert set(method.passes.get(tier, ())) <= set(PASSES)
    assert all(setting.problem(setting.default) is None for setting in method.settings.values())


def test_opacity_thresholds_are_noted() -> None:
    for name, method in METHODS.items():
        retained = method.retained.get("standard")
        noted = retained is not None and any("ste_threshold" in note for note in retained.notes.values())
        assert retained is None or noted is ("ste_threshold" in method.settings), name


def test_the_command_lists_every_method(here: Here) -> None:
    data = here("methods", "--json", "-").json
    assert data["methods"]["two_dts"]["paper_name"] == "2dts"
    assert set(data["methods"]) == set(METHODS)
