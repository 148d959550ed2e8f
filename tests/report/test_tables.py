"""Our own tables: what is bold, what is N/A or -- and why, partial means, the paper's rows under ours."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from msb.bench.aggregate import SCENES
from msb.bench.documents import AuditDocument, ChamferDocument
from msb.bench.records import Cell as Place
from msb.bench.records import Floor, Reason, RendererInfo, Result, Training
from msb.metrics.vgg import weights_source
from msb.report.build import build_report
from msb.report.collect import NOT_RUN, REFERENCE, SOUP, STE
from msb.report.layout import mark_best
from msb.report.metric_format import text
from msb.report.numbers import MEAN, Key, Number, Numbers
from msb.report.paper import contradictions, paper_numbers
from msb.report.report import Report
from msb.report.results import Place as ResultPlace
from msb.report.results import read_results
from msb.report.table import Cell, Column, Row, Table
from msb.report.tables import measured
from msb.report.tables.asset import asset_tables
from msb.report.tables.gaps import gaps_table
from msb.report.tables.measured import DRIVER_NOTE
from msb.report.tables.reproducibility import reproducibility_statistics
from tests.report.documents import AUDIT, chamfer
from tests.report.factory import (
    METRICS,
    at_rate,
    make_result,
    measure,
    numbers_of,
    write,
    write_results,
)


def row_of(table: Table, *labels: str) -> Row:
    (found,) = [row for row in table.rows if row.labels == labels and not row.paper]
    return found


def test_our_means_are_the_papers_where_the_records_are(numbers: Numbers) -> None:
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


def test_the_papers_row_stands_under_ours(numbers: Numbers) -> None:
    table = measured.native_summary(numbers, paper_numbers())
    first, second = table.rows[:2]
    assert (first.paper, second.paper) == (False, True)
    assert second.labels == ("Mip-NeRF 360", "in the paper")
    assert table.to_dict()["rows"][1]["source"] == "paper"


def test_ties_at_the_printed_precision_are_all_bold() -> None:
    cells = [Cell(text("psnr", value), value, "psnr") for value in (27.124, 27.118, 27.11)]
    marked = mark_best(cells, ["x"] * 3, alone=False)
    assert [cell.bold for cell in marked] == [True, True, False]
    cells = [Cell("0.2", 0.2, "lpips"), Cell("0.3", 0.3, "lpips"), Cell("6", 6.0, "mean_valence")]
    assert [cell.bold for cell in mark_best(cells, ["x"] * 3, alone=True)] == [True, False, False]
    cells = [Cell("27.1", 27.1, "psnr"), Cell("N/A", None, "psnr")]
    assert [mark_best(cells, ["x"] * 2, alone=alone)[0].bold for alone in (False, True)] == [False, True]


def partial(root: Path) -> Numbers:
    """Return numbers of which one scene is missing, one failed, and one condition is not supported."""
    write_results(root, datasets=["mipnerf360"], methods=["two_dts", "diffsoup"])
    (root / "cells/mipnerf360/garden/two_dts/standard/result.json").unlink()
    cell = Place(dataset="mipnerf360", scene="room", method="two_dts", condition="standard")
    reason = Reason(code="OPENCL_BUILD", message="no device")
    write(root, Result(cell=cell, status="failed", reason=reason, seconds=1.0))
    return numbers_of(root)


def test_partial_means_say_of_how_many_scenes(tmp_path: Path) -> None:
    numbers = partial(tmp_path)
    table = measured.renderer_comparison(numbers, "mipnerf360")
    cell = row_of(table, "Standard", "by OpenCL", "PSNR ↑").cells[0]
    assert cell.text.endswith(" (7/9)")
    assert any("bicycle" in note and "garden" not in note for note in cell.notes)
    assert cell.to_dict()["partial"] is True
    values = [
        numbers.value(Key("mipnerf360", s, "two_dts", "standard", "psnr")) for s in SCENES["mipnerf360"]
    ]
    known = [value for value in values if value is not None]
    assert cell.value == pytest.approx(sum(known) / 7, rel=1e-12)
    indoor = numbers.number(Key("mipnerf360", "indoor_mean", "two_dts", "standard", "psnr"))
    assert (indoor.present, indoor.expected) == (3, 4)


def test_missing_failed_and_unsupported_are_told_apart(tmp_path: Path) -> None:
    numbers = partial(tmp_path)
    of = Key("mipnerf360", "garden", "two_dts", "standard", "psnr")
    assert numbers.number(of) == Number(None, "--", NOT_RUN)
    failed = numbers.number(of._replace(scene="room"))
    assert (failed.absent, "OPENCL_BUILD" in str(failed.reason)) == ("--", True)
    unsupported = numbers.number(of._replace(method="diffsoup"))
    assert unsupported.absent == "N/A"
    assert numbers.number(of._replace(method="diffsoup", scene=MEAN)).absent == "N/A"
    table = measured.per_scene(numbers, "mipnerf360", "standard")
    assert {cell.text for cell in row_of(table, "garden").cells} == {"--", "N/A"}
    assert all(cell.reason for cell in row_of(table, "garden").cells)


def test_no_cell_is_ever_blank(whole: Report) -> None:
    for table in whole.tables.values():
        assert table.rows
        for row in table.rows:
            assert len(row.cells) == len(table.columns)
            assert all(cell.text for cell in row.cells)
            assert all((cell.value is None) == (cell.text in ("N/A", "--")) for cell in row.cells)


def test_gaps_between_incomparable_paths_say_why(tmp_path: Path) -> None:
    measure(tmp_path, "non_engine")
    measure(tmp_path, "dedicated", setup={"background": (1.0, 1.0, 1.0)})
    numbers = numbers_of(tmp_path, allow_mixed=True)
    row = row_of(gaps_table(numbers, "capture"), "PSNR ↑", "2DTS")
    assert (row.cells[0].text, row.cells[1].text) == ("--", "--")
    assert row.cells[0].reason != row.cells[1].reason


def test_mean_percentiles_are_means_of_scenes(tmp_path: Path) -> None:
    # Scenes of [1, 1, 1, 9] and [2, 2, 2, 2] ms: P95 7.8 and 2; of all frames it would be 6.55.
    for scene, p95 in (("train", 7.8), ("truck", 2.0)):
        measure(tmp_path, "dedicated", dataset="tanksandtemples", scene=scene, timing={"p95_ms": p95})
    table = measured.latency(numbers_of(tmp_path), "tanksandtemples")
    assert row_of(table, "Mean").cells[1].text == "4.9"


@pytest.mark.parametrize("kind", ["gpu", "cpu"])
def test_the_frame_rate_of_a_cpu_is_not_marked_as_the_best(tmp_path: Path, kind: str) -> None:
    for method in ("two_dts", "mesh_splatting"):
        timing = {"device_kind": kind, **at_rate(100.0 + len(method))}
        measure(tmp_path, "dedicated", method=method, timing=timing)
    numbers = numbers_of(tmp_path)
    assert any("Made-up GPU" in note for note in measured.latency(numbers, "capture").notes) == (
        kind == "cpu"
    )
    row = measured.per_scene(numbers, "capture", "dedicated").rows[0]
    bold = {cell.metric for cell in row.cells if cell.bold}
    assert ("fps" in bold, "psnr" in bold) == (kind == "gpu", True)


def test_a_note_says_which_weights_lpips_is_of(tmp_path: Path) -> None:
    vgg = {"file": "v.npz", "sha256": "ab" * 32, "known": None}
    weights = {"vgg": vgg, "heads": {"known": "lpips 0.1.4"}}
    metrics = (*METRICS, {"name": "lpips_vgg", "weights": weights})
    measure(tmp_path, "non_engine", dataset="tanksandtemples", scene="train", quality={"metrics": metrics})
    table = measured.native_summary(numbers_of(tmp_path))
    assert f"LPIPS: {weights_source(weights)}" in table.notes


@pytest.mark.parametrize("told", [5 << 30, None])
def test_the_drivers_figure_stands_beside_our_buffers_where_there_is_one(
    tmp_path: Path, told: int | None
) -> None:
    made = measure(tmp_path, "dedicated", memory={"driver_bytes": told})
    numbers = numbers_of(tmp_path)
    of_asset = asset_tables(ResultPlace("capture", "desk", "two_dts"), {"dedicated": made}, numbers)
    for table in (measured.memory(numbers, "capture"), of_asset["memory"]):
        assert (table.rows[0].cells[-1].text == "5120", DRIVER_NOTE in table.notes) == (bool(told),) * 2


def test_a_single_triangle_has_a_row_below_the_means(tmp_path: Path) -> None:
    for scene, size in (("train", 30 << 20), ("truck", 50 << 20)):
        floor = Floor(width=980, height=545, p50_ms=0.5, p95_ms=0.7, memory_bytes=size)
        measure(tmp_path, "standard", dataset="tanksandtemples", scene=scene, floor=floor)
    measure(tmp_path, "dedicated", dataset="tanksandtemples", scene="train")
    numbers = numbers_of(tmp_path)
    memory, latency = (make(numbers, "tanksandtemples") for make in (measured.memory, measured.latency))
    assert [cell.text for cell in row_of(memory, "Floor").cells] == ["--", "40"]
    assert [cell.text for cell in row_of(latency, "Floor").cells] == ["--", "--", "0.5", "0.7"]
    both = measured.runtime_resources(numbers, "tanksandtemples")
    shown = [
        cell.text
        for column, cell in zip(both.columns, both.rows[-1].cells, strict=True)
        if "Floor" in column.groups
    ]
    assert shown == ["0.5", "0.7", "40"]
    assert numbers.scenes("tanksandtemples") == ["train", "truck"]


def test_what_is_of_the_model_needs_no_images_of_its_own_renderer(tmp_path: Path) -> None:
    distance = ChamferDocument.of(chamfer(0.75))
    trained = Training(seconds=1500.0, peak_memory_bytes=None, source="track.json")
    for scene in SCENES["dtu"]:
        parts = {"chamfer": distance, "training": trained}
        write(tmp_path, make_result("dtu", scene, "two_dts", "exported_mesh", **parts))
    write(tmp_path, make_result("dtu", SCENES["dtu"][0], "mesh_splatting", "exported_mesh"))
    alone = build_report(read_results(tmp_path), pictures=False, with_paper=False)
    summary = alone.tables["native_summary"]
    assert [row.labels[-1] for row in summary.rows] == ["2DTS"], "the other has no such number"
    assert {cell.text for cell in summary.rows[0].cells} == {"0.75", "25.0", "--"}
    scenes = alone.tables["scenes-dtu-non_engine"]
    assert [column.of["metric"] for column in scenes.columns] == ["chamfer"]
    # They make no condition of images, neither here nor beside a method that has one.
    assert alone.numbers.conditions("dtu") == []
    write(tmp_path, make_result("dtu", SCENES["dtu"][0], "mesh_splatting", "non_engine"))
    both = build_report(read_results(tmp_path), pictures=False, with_paper=False)
    assert len(both.tables["native_summary"].rows) == 2
    assert [column.title for column in both.tables["renderer_comparison-dtu"].columns] == ["MeshSplatting"]


def test_where_nothing_of_the_model_is_known_there_is_no_row_and_no_column_of_dashes(tmp_path: Path) -> None:
    trained = Training(seconds=1500.0, peak_memory_bytes=None, source="track.json")
    write(tmp_path, make_result("dtu", "scan24", "two_dts", "exported_mesh", training=trained))
    lost = {"training": Reason(code="FILE_NOT_FOUND", message="there is no such file")}
    write(tmp_path, make_result("mipnerf360", "garden", "two_dts", "dedicated", reasons=lost))
    tables = build_report(read_results(tmp_path), pictures=False).tables
    assert [row.labels for row in tables["native_summary"].rows if not row.paper] == [("DTU", "2DTS")]
    assert "scenes-mipnerf360-dedicated" in tables
    assert not any(name.endswith("-non_engine") for name in tables)


def test_a_soup_with_a_degenerate_row_is_one_as_in_its_verdict(tmp_path: Path) -> None:
    counts = {**AUDIT["counts"], "faces": 1001, "repeated_index_faces": 1, "referenced_vertices": 3000}
    measure(tmp_path, "exported_mesh", audit=AuditDocument.of({**AUDIT, "counts": counts}))
    key = Key("capture", "desk", "two_dts", "exported_mesh", "nonmanifold_vertex_ratio")
    assert SOUP in numbers_of(tmp_path).number(key).notes


def test_our_reference_is_not_passed_off_as_official(tmp_path: Path) -> None:
    own = RendererInfo(name="reference", version="1", kind="msb_reference")
    measure(tmp_path, "non_engine", renderer=own)
    measure(tmp_path, "non_engine", method="diffsoup")
    first, second = measured.native_summary(numbers_of(tmp_path)).rows
    assert first.cells[0].notes == (REFERENCE,)
    assert second.cells[0].notes == ()


def test_another_image_folder_is_noted(tmp_path: Path) -> None:
    for method in ("two_dts", "triangle_splatting", "diffsoup"):
        folder = "images_4" if method == "diffsoup" else "images_2"
        measure(tmp_path, "non_engine", method=method, setup={"image_folder": folder})
    numbers = numbers_of(tmp_path)
    key = Key("capture", "desk", "diffsoup", "non_engine", "psnr")
    (note,) = numbers.number(key).notes
    assert "images_4" in note
    assert numbers.number(key._replace(method="two_dts")).notes == ()


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
def test_what_contradicts_the_papers_numbers_stands_where_they_do(whole: Report, results: Path) -> None:
    (known,) = [note for note in contradictions()["slowdown"] if "on the host" in note]
    assert f"in the paper: {known}" in whole.tables["slowdown"].notes
    alone = build_report(read_results(results), pictures=False, with_paper=False)
    assert not any("in the paper" in note for table in alone.tables.values() for note in table.notes)


def test_short_trainings_and_small_memory_show_digits_and_the_best_by_them(tmp_path: Path) -> None:
    for method, seconds in (("two_dts", 1.2), ("mesh_splatting", 2.4), ("diffsoup", 90.0)):
        training = {"seconds": seconds, "peak_memory_bytes": 1 << 33}
        measure(tmp_path, "non_engine", method=method, training=training)
    cells = [row.cells for row in measured.native_summary(numbers_of(tmp_path)).rows]
    shown = {cell.text: cell.bold for row in cells for cell in row if cell.metric == "train_seconds"}
    assert shown == {"0.02": True, "0.04": False, "1.5": False}


@pytest.mark.parametrize("threshold", [None, 0.1])
def test_opacity_that_hides_faces_on_standard_is_noted(tmp_path: Path, threshold: float | None) -> None:
    for condition in ("dedicated", "standard"):
        measure(tmp_path, condition, 20.0, renderer={"settings": {"ste_threshold": threshold}})
    numbers = numbers_of(tmp_path)
    key = Key("capture", "desk", "two_dts", "standard", "psnr")
    assert (STE in numbers.number(key).notes) == (threshold is not None)
    assert STE not in numbers.number(key._replace(condition="dedicated")).notes


@pytest.mark.parametrize(
    ("dataset", "scene", "beside"),
    [("mipnerf360", "garden", True), ("mipnerf360", "pebble", False), ("dtu", "scan24", False)],
)
def test_the_papers_mesh_stands_beside_meshes_of_its_dataset(
    tmp_path: Path, dataset: str, scene: str, beside: bool
) -> None:
    made = measure(tmp_path, "exported_mesh", dataset=dataset, scene=scene)
    place = ResultPlace(dataset, scene, "two_dts")
    table = asset_tables(place, {"exported_mesh": made}, numbers_of(tmp_path))["structure"]
    name = "MeshSplatting, mean of Mip-NeRF 360 in the paper"
    assert [row.labels[0] for row in table.rows] == ["this mesh", *([name] if beside else [])]


def test_components_are_in_millions_unless_that_says_nothing() -> None:
    shown = [text("components", value) for value in (715_000, 100_000, 99_999, 3)]
    assert shown == ["0.71 M", "0.10 M", "99,999", "3"]


def test_notes_of_all_cells_move_to_the_table() -> None:
    cells = tuple(Cell("1", 1.0, "psnr", notes=notes) for notes in (("both",), ("both", "one")))
    table = Table("x", "x", ("x",), (Column("a"), Column("b")), (Row(("r",), cells),)).with_common_notes()
    assert table.notes == ("both",)
    assert table.footnotes() == {"one": "a"}


def test_json_holds_full_doubles(numbers: Numbers) -> None:
    data: dict[str, Any] = measured.renderer_comparison(numbers, "mipnerf360").to_dict()
    cell = data["rows"][0]["cells"][0]
    mean = numbers.value(Key("mipnerf360", MEAN, "two_dts", "non_engine", "psnr"))
    assert cell["value"] == mean
    assert cell["text"] == f"{mean:.2f}"
    assert (cell["metric"], cell["unit"]) == ("psnr", "dB")
