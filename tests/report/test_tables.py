"""Tables and findings that golden.md does not cover: bold and missing values, notes, the paper's rows."""

import re
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_rel

from msb.bench.aggregate import SCENES
from msb.bench.documents import AuditDocument
from msb.bench.records import Reason, Training
from msb.errors import UsageError
from msb.report.build import EQUIVALENTS, build_report
from msb.report.collect import OUR_TRAINER, SOUP
from msb.report.findings import Finding, derive_findings
from msb.report.layout import mark_best
from msb.report.method_comparison import adjust_by_holm
from msb.report.metric_format import format_change, format_value
from msb.report.numbers import MEAN, ON_CPU, Key, Number, Numbers
from msb.report.paper import contradictions, paper_numbers
from msb.report.report import Report
from msb.report.results import Place as ResultPlace
from msb.report.results import read_results
from msb.report.table import Table, TableCell, TableColumn, TableRow
from msb.report.tables import measurements
from msb.report.tables.asset import asset_tables
from msb.report.tables.gaps import PAPER_NOTE
from msb.report.tables.measurements import DRIVER_NOTE
from msb.report.tables.reproducibility import reproducibility_statistics
from tests.report.factory import (
    AUDIT,
    make_result,
    measure,
    numbers_of,
    timing,
    write,
)
from tests.report.test_golden import compare, metrics_of_the_model


def row_of(table: Table, *labels: str) -> TableRow:
    (row,) = [row for row in table.rows if row.labels == labels and not row.paper]
    return row


def test_means_of_synthetic_records_equal_the_papers(numbers: Numbers) -> None:
    paper, compared = paper_numbers(), 0
    for key, published in paper.values.items():
        if (
            key.scene == MEAN
            and not key.source
            and published.value is not None
            and key.metric != "components"
        ):
            ours = numbers.number(key)
            if ours.value is not None and key.condition != "exported_mesh":
                assert ours.value == pytest.approx(published.value, rel=1e-6), key
                assert (ours.present, ours.expected) == (len(SCENES[key.dataset]),) * 2
                compared += 1
    assert compared > 200


def test_the_papers_row_follows_ours(numbers: Numbers) -> None:
    table = measurements.native_summary(numbers, paper_numbers())
    first, second = table.rows[:2]
    assert (first.paper, second.paper) == (False, True)
    assert second.labels == ("Mip-NeRF 360", "in the paper")
    assert table.to_dict()["rows"][1]["source"] == "paper"


def test_ties_at_the_printed_precision_are_all_bold() -> None:
    cells = [TableCell(format_value("psnr", value), value, "psnr") for value in (27.124, 27.118, 27.11)]
    marked = mark_best(cells, ["x"] * 3, single=False)
    assert [cell.bold for cell in marked] == [True, True, False]
    cells = [
        TableCell("0.2", 0.2, "lpips"),
        TableCell("0.3", 0.3, "lpips"),
        TableCell("6", 6.0, "mean_valence"),
    ]
    assert [cell.bold for cell in mark_best(cells, ["x"] * 3, single=True)] == [True, False, False]
    cells = [TableCell("27.1", 27.1, "psnr"), TableCell("N/A", None, "psnr")]
    assert [mark_best(cells, ["x"] * 2, single=single)[0].bold for single in (False, True)] == [False, True]


def test_no_cell_is_ever_blank(whole: Report) -> None:
    for table in whole.tables.values():
        assert table.rows
        for row in table.rows:
            assert len(row.cells) == len(table.columns)
            assert all(cell.text for cell in row.cells)
            assert all((cell.value is None) == (cell.text in ("N/A", "--")) for cell in row.cells)


@pytest.mark.parametrize("driver_bytes", [5 << 30, None])
def test_memory_reported_by_the_driver_has_a_column(tmp_path: Path, driver_bytes: int | None) -> None:
    record = measure(tmp_path, "dedicated", memory={"driver_bytes": driver_bytes})
    numbers = numbers_of(tmp_path)
    of_asset = asset_tables(ResultPlace("capture", "desk", "two_dts"), {"dedicated": record}, numbers)
    for table in (measurements.memory(numbers, "capture"), of_asset["memory"]):
        assert (table.rows[0].cells[-1].text == "5120", DRIVER_NOTE in table.notes) == (
            bool(driver_bytes),
        ) * 2


def test_unsteady_frame_rates_are_not_printed_ranked_or_compared(tmp_path: Path) -> None:
    for method, rounds in (("two_dts", (20.0, 900.0)), ("mesh_splatting", (99.0, 101.0))):
        for condition in ("dedicated", "standard"):
            times = timing(100.0, round_fps=rounds, device_kind="gpu")
            write(tmp_path, make_result("mipnerf360", "garden", method, condition, timing=times))
    report = build_report(read_results(tmp_path), with_paper=False, pictures=False)
    tables = report.tables
    rates = row_of(tables["slowdown"], "Mip-NeRF 360", "2DTS").cells
    assert (rates[0].text, rates[0].value) == ("unsteady", None)
    assert row_of(tables["slowdown"], "Mip-NeRF 360", "MeshSplatting").cells[0].value == 1
    table = tables["scenes-mipnerf360-dedicated"]
    cells = {
        column.of["method"]: row.cells[place]
        for row in table.rows[:1]
        for place, column in enumerate(table.columns)
        if column.of["metric"] == "fps"
    }
    assert (cells["two_dts"].text, cells["two_dts"].value, cells["two_dts"].bold) == ("unsteady", None, False)
    assert cells["mesh_splatting"].value == 100
    assert not any("2DTS" in f.sentence for f in report.findings if f.kind in ("slowdown", "leaders"))


def test_ratios_of_a_cpu_name_it_in_the_table_and_in_the_sentence(tmp_path: Path) -> None:
    for condition, fps in (("dedicated", 10.0), ("standard", 40.0)):
        record = make_result("mipnerf360", "garden", "two_dts", condition, timing=timing(fps))
        write(tmp_path, record)
    report = build_report(read_results(tmp_path), with_paper=False, pictures=False)
    table = report.tables["slowdown"]
    assert row_of(table, "Mip-NeRF 360", "2DTS").cells[0].value == 4
    assert any(note.startswith(ON_CPU) for note in table.notes)
    (sentence,) = [finding.sentence for finding in report.findings if finding.kind == "slowdown"]
    assert "CPU" in sentence


@pytest.mark.parametrize("trainer", ["official", "ours"])
def test_training_memory_that_was_not_measured_has_the_reason_of_its_record(
    tmp_path: Path, trainer: str
) -> None:
    why = "nvidia-ml-py is not installed"
    trained = Training(
        seconds=90.0, peak_memory_bytes=None, source="t.json", memory_reason=why, trainer=trainer
    )
    write(tmp_path, make_result("capture", "desk", "two_dts", "non_engine", training=trained))
    numbers = numbers_of(tmp_path)
    key = Key("capture", MEAN, "two_dts", "non_engine", "train_memory")
    assert why in str(numbers.number(key).reason)
    minutes = numbers.number(key._replace(metric="train_seconds"))
    assert (minutes.value, OUR_TRAINER in minutes.notes) == (90.0, trainer == "ours")


def test_gaps_beside_the_papers_say_that_these_could_not_be_reproduced(whole: Report) -> None:
    assert PAPER_NOTE in whole.tables["gaps-mipnerf360"].notes
    assert not any(row.paper for row in whole.tables["gaps-dtu"].rows)
    assert PAPER_NOTE not in whole.tables["gaps-dtu"].notes


def test_published_numbers_of_other_scenes_are_shown_with_their_note(tmp_path: Path) -> None:
    measure(tmp_path, "non_engine", 30.0, dataset="mipnerf360", scene="pebble")
    key = Key("mipnerf360", "pebble", "two_dts", "non_engine", "psnr", "paper")
    published = {
        key: Number(29.0, notes=("invented",)),
        key._replace(scene=MEAN): Number(29.0, notes=("invented",)),
    }
    report = build_report(read_results(tmp_path), published=published)
    row = row_of(report.tables["reproducibility"], "Mip-NeRF 360", "2DTS")
    assert [cell.text for cell in row.cells if cell.metric == "psnr"] == ["29.00", "30.00"]
    assert "invented" in report.tables["reproducibility_statistics"].notes
    (figure,) = [
        figure
        for section in report.sections
        for figure in section.figures
        if "reproducibility" in figure.name
    ]
    assert "invented" in figure.caption


def test_comprehensive_native_results_have_every_scene_and_the_means(whole: Report) -> None:
    table, summary = (whole.tables[name] for name in ("native_comprehensive_results", "native_summary"))
    assert [column.of for column in table.columns] == [column.of for column in summary.columns]
    means = {
        (row.labels[0], row.labels[2]): row.cells
        for row in table.rows
        if row.labels[1] == "Mean" and not row.paper
    }
    assert means == {row.labels: row.cells for row in summary.rows if not row.paper}
    scenes = {(row.labels[0], row.labels[1]) for row in table.rows}
    assert len(scenes) == sum(len(names) + 1 for names in SCENES.values())
    assert all(row.labels[1] == "Mean" for row in table.rows if row.paper)


@pytest.mark.parametrize("label", sorted(EQUIVALENTS))
def test_labels_of_the_paper_select_the_same_table_of_the_results(whole: Report, label: str) -> None:
    assert EQUIVALENTS[label] in whole.tables


def test_metrics_of_the_model_do_not_imply_images(tmp_path: Path) -> None:
    metrics_of_the_model(tmp_path)
    assert numbers_of(tmp_path).conditions("dtu") == []
    write(tmp_path, make_result("dtu", SCENES["dtu"][0], "mesh_splatting", "non_engine"))
    both = build_report(read_results(tmp_path), pictures=False, with_paper=False)
    assert len(both.tables["native_summary"].rows) == 2
    assert [column.title for column in both.tables["renderer_comparison-dtu"].columns] == ["MeshSplatting"]


def test_methods_without_metrics_of_the_model_have_no_row_and_no_column(tmp_path: Path) -> None:
    trained = Training(seconds=1500.0, peak_memory_bytes=None, source="track.json")
    write(tmp_path, make_result("dtu", "scan24", "two_dts", "exported_mesh", training=trained))
    lost = {"training": Reason(code="FILE_NOT_FOUND", message="the file does not exist")}
    write(tmp_path, make_result("mipnerf360", "garden", "two_dts", "dedicated", reasons=lost))
    tables = build_report(read_results(tmp_path), pictures=False).tables
    assert [row.labels for row in tables["native_summary"].rows if not row.paper] == [("DTU", "2DTS")]
    assert "scenes-mipnerf360-dedicated" in tables
    assert not any(name.endswith("-non_engine") for name in tables)


def test_a_soup_with_a_degenerate_face_is_noted_as_a_soup(tmp_path: Path) -> None:
    counts = {**AUDIT["counts"], "faces": 1001, "repeated_index_faces": 1, "referenced_vertices": 3000}
    measure(tmp_path, "exported_mesh", audit=AuditDocument.of({**AUDIT, "counts": counts}))
    key = Key("capture", "desk", "two_dts", "exported_mesh", "nonmanifold_vertex_ratio")
    assert SOUP in numbers_of(tmp_path).number(key).notes


def test_reproducibility_statistics_name_the_worst_pair(numbers: Numbers) -> None:
    paper = paper_numbers()
    scene = Key("mipnerf360", "treehill", "triangle_splatting", "non_engine", "psnr", "paper")
    ours = numbers.value(scene._replace(source=""))
    published = replace(paper, values={**paper.values, scene: Number(ours + 0.2)})
    table = reproducibility_statistics(numbers, published)
    row = row_of(table, "Paper", "scenes", "PSNR")
    assert [cell.text for cell in row.cells][:3] == ["1", "0.200", "0.200"]
    assert "treehill (-0.200)" in row.cells[4].text
    means = row_of(table, "Public", "means of datasets", "PSNR")
    assert means.cells[0].text == "8"
    assert means.cells[3].value == pytest.approx(100 * 0.93 / 18.38, rel=1e-6)


@pytest.mark.slow
def test_contradictions_are_noted_beside_the_papers_numbers(whole: Report, results: Path) -> None:
    (known,) = [note for note in contradictions()["slowdown"] if "on the host" in note]
    assert f"in the paper: {known}" in whole.tables["slowdown"].notes
    alone = build_report(read_results(results), pictures=False, with_paper=False)
    assert not any("in the paper" in note for table in alone.tables.values() for note in table.notes)


@pytest.mark.parametrize(
    ("dataset", "scene", "beside"),
    [("mipnerf360", "garden", True), ("mipnerf360", "pebble", False), ("dtu", "scan24", False)],
)
def test_the_papers_mesh_is_compared_with_meshes_of_its_dataset(
    tmp_path: Path, dataset: str, scene: str, beside: bool
) -> None:
    record = measure(tmp_path, "exported_mesh", dataset=dataset, scene=scene)
    place = ResultPlace(dataset, scene, "two_dts")
    table = asset_tables(place, {"exported_mesh": record}, numbers_of(tmp_path))["structure"]
    name = "MeshSplatting, mean of Mip-NeRF 360 in the paper"
    assert [row.labels[0] for row in table.rows] == ["this mesh", *([name] if beside else [])]


def test_notes_of_all_cells_move_to_the_table() -> None:
    cells = tuple(TableCell("1", 1.0, "psnr", notes=notes) for notes in (("both",), ("both", "one")))
    table = Table(
        "x", "x", ("x",), (TableColumn("a"), TableColumn("b")), (TableRow(("r",), cells),)
    ).with_common_notes()
    assert table.notes == ("both",)
    assert table.footnotes() == {"one": "a"}


def test_findings_on_speed_and_structure_are_never_dropped(numbers: Numbers) -> None:
    assert len(numbers.datasets()) == 4
    many = [Finding("against", f"Number {number}.", "against") for number in range(20)]
    for first in ([], many):
        kinds = [finding.kind for finding in derive_findings(numbers, first)]
        assert {"slowdown", "structure", "training", "unsupported"} <= set(kinds)
        assert len(kinds) <= 12
        assert kinds.count("ranking") <= 1
    assert (kinds[0], len(kinds)) == ("against", 12)
    assert derive_findings(Numbers({})) == []


def test_differences_are_tested_by_a_paired_t_test_over_scenes(tmp_path: Path) -> None:
    theirs, ours = [24.0, 25.0, 26.0, 27.0], [24.5, 25.6, 26.7, 27.8]
    compare(tmp_path, ("desk", "chair", "room", "hall"), "mesh_splatting", *theirs)
    compare(tmp_path, ("desk", "chair", "room", "hall"), "two_dts", *ours)
    expected = ttest_rel(ours, theirs)
    ends = expected.confidence_interval(0.95)
    report = build_report(read_results(tmp_path), pictures=False, against="mesh_splatting")
    better, low, high, p, holm, over = report.tables["against"].rows[0].cells
    assert (better.text, low.text, high.text, over.text) == ("+0.65", "+0.44", "+0.86", "4 scenes")
    assert [low.value, high.value, p.value] == pytest.approx([ends.low, ends.high, expected.pvalue], rel=1e-9)
    assert holm.value == p.value, "SSIM is equal everywhere, so there is one test"
    assert better.to_dict()["interval_over"] == "4 scenes"
    assert better.to_dict()["significant"] is True


def test_a_note_explains_that_there_is_nothing_to_compare(tmp_path: Path) -> None:
    compare(tmp_path, ["desk"], "mesh_splatting", 24.0)
    report = build_report(read_results(tmp_path), pictures=False, against="mesh_splatting")
    assert "against" not in report.tables
    assert report.notes[0].startswith("--against mesh_splatting: ")
    with pytest.raises(UsageError, match="USAGE"):
        build_report(read_results(tmp_path), pictures=False, against="two_dts")


@pytest.mark.parametrize("seed", range(20))
def test_a_printed_change_is_the_difference_of_its_printed_ends(seed: int) -> None:
    first, last = np.random.default_rng(seed).uniform(20, 21, 2)
    amount, *ends = map(Decimal, format_change(first - last, (first, last), 2))
    assert abs(ends[0] - ends[1]) == amount
    assert float(amount) == pytest.approx(abs(first - last), abs=0.005)


def test_ends_of_other_scenes_are_printed_with_two_digits() -> None:
    assert format_change(1.0, (20.0, 18.0), 2) == ("1.00", "20.00", "18.00")


def test_halves_are_rounded_up_and_means_of_counts_keep_their_fraction() -> None:
    assert [format_value("fps", value) for value in (0.5, 1.5, 2.5)] == ["1", "2", "3"]
    assert [format_value("components", value) for value in (1.0, 4.5, 13 / 3, 1000.5)] == [
        "1",
        "4.5",
        "4.3",
        "1,001",
    ]
    assert format_value("tasks", 6.5) == "6.5"


@pytest.mark.parametrize("loss", [0.0, 5.0])
def test_a_comparison_has_one_finding_per_dataset_with_the_sign_of_its_interval(
    tmp_path: Path, loss: float
) -> None:
    for number, scene in enumerate(("desk", "chair")):
        for condition in ("non_engine", "dedicated", "standard"):
            for method, psnr in (("two_dts", 20 - loss + 3 * number), ("mesh_splatting", 20 - 3 * number)):
                measure(tmp_path, condition, psnr, method=method, scene=scene)
    report = build_report(read_results(tmp_path), with_paper=False, pictures=False, against="mesh_splatting")
    (finding,) = [finding for finding in report.findings if finding.kind == "against"]
    assert finding.sentence.count("not significant") == 1
    amount, low, high = map(float, re.findall(r"-?\d+\.\d\d(?= dB| to|,)", finding.sentence)[:3])
    assert low < amount < high
    assert (amount - low) == pytest.approx(high - amount, abs=0.02)


def test_p_values_are_adjusted_by_holms_method() -> None:
    assert adjust_by_holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert adjust_by_holm([0.9, 0.8]) == [1.0, 1.0]
    assert adjust_by_holm([]) == []
