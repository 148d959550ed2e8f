"""Methods against one of them: paired by view and scene, with intervals, p and p for all tests together."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_rel

from msb.bench.records import Setup
from msb.errors import UsageError
from msb.report.against import holm
from msb.report.build import build_report
from msb.report.report import Report
from msb.report.results import read_results
from tests.report.factory import measure

SCENES = ("desk", "chair", "room", "hall")


def shown(root: Path, method: str, scene: str, psnr: float, **changes: Any) -> list[float]:
    """Write a record of three views around `psnr`, and return their values."""
    shifts = np.random.default_rng(len(method + scene) + round(psnr)).normal(0, 0.3, 3)
    shifts -= shifts.mean()
    measure(root, "standard", psnr, shifts=tuple(shifts), method=method, scene=scene, **changes)
    return list(psnr + shifts)


def report(root: Path) -> Report:
    return build_report(read_results(root), pictures=False, against="mesh_splatting")


def test_the_difference_is_that_of_a_paired_test_over_scenes(tmp_path: Path) -> None:
    for number, scene in enumerate(SCENES):
        shown(tmp_path, "mesh_splatting", scene, 24.0 + number)
        shown(tmp_path, "two_dts", scene, 24.5 + 1.1 * number)
    wanted = ttest_rel([24.5 + 1.1 * n for n in range(4)], [24.0 + n for n in range(4)])
    ends = wanted.confidence_interval(0.95)
    made = report(tmp_path)
    (row, _) = made.tables["against"].rows
    assert row.labels == ("Standard", "PSNR ↑", "2DTS")
    better, low, high, p, holm, over = row.cells
    assert (better.text, low.text, high.text, over.text) == ("+0.65", "+0.44", "+0.86", "4 scenes")
    assert [low.value, high.value, p.value] == pytest.approx([ends.low, ends.high, wanted.pvalue], rel=1e-9)
    assert holm.value == p.value, "SSIM is equal everywhere, so there is one test"
    for value in ("over 4 scenes", "0.65 dB better", "0.44 to 0.86", "p = 0.002"):
        assert value in made.findings[0].sentence
    assert better.to_dict()["interval_over"] == "4 scenes"
    assert better.to_dict()["significant"] is True


def test_one_scene_is_compared_by_its_views_and_what_is_worse_is_said_to_be(tmp_path: Path) -> None:
    theirs = shown(tmp_path, "mesh_splatting", "desk", 24.0)
    ours = shown(tmp_path, "two_dts", "desk", 21.0)
    made = report(tmp_path)
    better, _, _, p, *_ = made.tables["against"].rows[0].cells
    assert (better.text, p.value) == ("-3.00", pytest.approx(ttest_rel(ours, theirs).pvalue, rel=1e-9))
    assert "2DTS is 3.00 dB worse" in made.findings[0].sentence
    assert made.notes


def test_only_cells_that_both_have_are_compared_and_others_say_why(tmp_path: Path) -> None:
    setup = Setup(camera_convention="gs_fov", image_folder="images_8", gt_resized=False, background=(1, 1, 1))
    for scene in SCENES[:3]:
        shown(tmp_path, "mesh_splatting", scene, 24.0)
        shown(tmp_path, "triangle_splatting", scene, 25.0, setup=setup)
    for scene in SCENES[1:]:
        shown(tmp_path, "two_dts", scene, 25.0 + len(scene))
    rows = {
        row.labels[2]: row.cells for row in report(tmp_path).tables["against"].rows if "PSNR" in row.labels[1]
    }
    assert [rows["2DTS"][0].text, rows["2DTS"][5].text] == ["+5.50 (2/4)", "2 scenes"]
    assert rows["Triangle-Splatting"][0].value is None


def test_another_background_is_a_methods_own_and_noted(tmp_path: Path) -> None:
    setup = Setup(camera_convention="full_K", image_folder="images_4", gt_resized=False, background=(1, 1, 1))
    for scene in SCENES:
        shown(tmp_path, "mesh_splatting", scene, 24.0)
        shown(tmp_path, "two_dts", scene, 24.0)
        shown(tmp_path, "triangle_splatting", scene, 25.0, setup=setup)
    table = report(tmp_path).tables["against"]
    cell = next(row.cells[0] for row in table.rows if row.labels[2] == "Triangle-Splatting")
    assert cell.value == pytest.approx(1.0)
    assert any("background white" in note for note in cell.notes)


def test_nothing_to_compare_is_said(tmp_path: Path) -> None:
    shown(tmp_path, "mesh_splatting", "desk", 24.0)
    made = report(tmp_path)
    assert "against" not in made.tables
    assert made.notes[0].startswith("against mesh_splatting: ")
    with pytest.raises(UsageError, match="USAGE"):
        build_report(read_results(tmp_path), pictures=False, against="two_dts")


def test_p_for_all_tests_together_is_holms() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []
