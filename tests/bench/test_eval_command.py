"""`msb eval`, and an image metric of another package in `msb eval`, runs, records and reports."""

import csv
import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from msb.bench.aggregate import METRICS
from msb.bench.records import ImageQuality, Quality, read_result
from msb.errors import InputError
from msb.metrics import registry
from msb.report.results import read_results
from tests.bench.protocols import make_protocol
from tests.cli.conftest import Msb
from tests.conftest import ROOT
from tests.metrics.conftest import GOLDEN, golden, needs_torch
from tests.report.factory import make_result, write
from tests.test_docs_commands import install_example

PRED, GT = GOLDEN / "pred", GOLDEN / "gt"
EXPECTED = ("smooth_plus_noise_37x53", "blurred_37x53", "identical_37x53")


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    return shutil.copytree(PRED, tmp_path / "pred"), shutil.copytree(GT, tmp_path / "gt")


@pytest.mark.slow
def test_json_and_csv_have_full_precision(msb: Msb, tmp_path: Path) -> None:
    cases = {case["id"]: case for case in golden("psnr_ssim.json")["cases"]}
    data = msb("eval", "--json", "-", "--csv", tmp_path / "rows.csv", PRED, GT).json
    assert (data["schema"], data["count"], data["partial"]) == ("msb.eval/1", 3, False)
    for row, name in zip(data["images"], EXPECTED, strict=True):
        assert float(row["psnr"]) == pytest.approx(float(cases[name]["psnr"]), abs=1e-6)
        assert row["ssim"] == pytest.approx(cases[name]["ssim"], abs=1e-9)
        assert row["lpips"] is None
    finite = [cases[name]["psnr"] for name in EXPECTED[:2]]
    assert data["mean"]["psnr"] == pytest.approx((sum(finite) + 100) / 3, abs=1e-6)
    assert (data["psnr_inf_count"], data["lpips_reason"] is None) == (1, False)
    assert [metric["name"] for metric in data["metrics"]] == ["psnr", "ssim"]
    rows = list(csv.DictReader((tmp_path / "rows.csv").read_text().splitlines()))
    assert float(rows[1]["psnr"]) == data["images"][1]["psnr"]
    assert (rows[2]["psnr"], rows[2]["lpips"]) == ("inf", "")
    msb("eval", "--csv", tmp_path / "rows.csv", PRED, GT).ends(2, "OUTPUT_EXISTS: ")
    (image,) = msb("eval", "--json", "-", PRED / "r_0.png", GT / "r_1.png").json["images"]
    assert image["name"] == "r_0"


@pytest.mark.slow
def test_each_bad_image_is_one_line_and_the_others_are_compared(msb: Msb, folders: tuple[Path, Path]) -> None:
    pred, gt = folders
    (pred / "r_0.png").write_bytes((pred / "r_0.png").read_bytes()[:200])
    Image.fromarray(np.zeros((5, 5, 3), np.uint8)).save(gt / "r_2.png")
    result = msb("eval", "--json", "-", pred, gt, status=3)
    first, second = result.err.splitlines()
    assert first.startswith(f"METRIC_IMAGE: {pred / 'r_0.png'}: ")
    assert second.startswith(f"METRIC_SIZES_DIFFER: {pred / 'r_2.png'}: ")
    data = result.json
    assert (data["count"], data["partial"]) == (1, True)
    assert data["mean"]["psnr"] == data["images"][0]["psnr"]
    assert [failure["name"] for failure in data["failed"]] == ["r_0", "r_2"]
    (pred / "r_1.npy").write_bytes(b"")
    alone = msb("eval", "--json", "-", pred, gt, status=3)
    assert (alone.json["mean"]["psnr"], len(alone.err.splitlines())) == (None, 3)
    (pred / "r_1.npy").unlink()
    msb("eval", pred, gt).ends(3, f"METRIC_IMAGE_NAMES: {pred}: ")
    assert len(msb("eval", "--subset", "--json", "-", pred, gt, status=3).json["failed"]) == 2


@pytest.mark.slow
def test_alpha_needs_a_background(msb: Msb, tmp_path: Path) -> None:
    red = np.zeros((20, 20, 4), np.uint8)
    red[..., 0], red[:10, :, 3] = 255, 255
    Image.fromarray(red).save(tmp_path / "a.png")
    over_white = np.where(red[..., 3:] > 0, red[..., :3], 255).astype(np.uint8)
    Image.fromarray(over_white).save(tmp_path / "b.png")
    result = msb("eval", tmp_path / "b.png", tmp_path / "a.png", status=3)
    assert result.err.startswith("METRIC_IMAGE_ALPHA: ")
    data = msb("eval", "--background", "white", "--json", "-", tmp_path / "b.png", tmp_path / "a.png").json
    assert data["images"][0]["psnr"] == "inf"
    assert data["background"] == [1, 1, 1]
    for background in ("official", "#12345", "2,0,0"):
        msb("eval", "--background", background, PRED, GT).ends(2, "USAGE: --background")
    for arguments in ((tmp_path / "none", GT), (PRED, tmp_path / "none")):
        msb("eval", *arguments).ends(3, "FILE_NOT_FOUND: ")


@needs_torch
def test_lpips(msb: Msb, vgg_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    result = msb("eval", "--vgg-weights", vgg_file, "--json", file, PRED, GT, OMP_NUM_THREADS="1", status=0)
    assert result.err.startswith(f"warning: METRIC_VGG_UNKNOWN: {vgg_file}: ")
    data = json.loads(file.read_text())
    assert data["lpips_reason"] is None
    assert data["images"][2]["lpips"] == 0
    assert data["mean"]["lpips"] == pytest.approx(sum(row["lpips"] for row in data["images"]) / 3)
    assert data["warnings"] == [result.err.strip()]
    assert data["metrics"][2]["weights"]["vgg"]["sha256"]
    msb("eval", "--vgg-weights", GT / "r_0.png", PRED, GT).ends(3, "METRIC_WEIGHTS: ")


@pytest.mark.slow
def test_an_error_of_all_images_is_printed_once(msb: Msb, tmp_path: Path) -> None:
    for folder, size in (("pred", (8, 6)), ("gt", (16, 12))):
        (tmp_path / folder).mkdir()
        for number in range(3):
            Image.new("RGB", size).save(tmp_path / folder / f"{number}.png")
    first, note = msb("eval", tmp_path / "pred", tmp_path / "gt", status=3).err.splitlines()
    assert (first.partition(":")[0], note.partition(":")[0]) == ("METRIC_SIZES_DIFFER", "note")


FAILS = ("    steps = [", "    1 / 0\n    steps = [")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return install_example("docs/extending.md", tmp_path / "site")


def test_reserved_metric_names_are_the_keys_of_records() -> None:
    fields = {*Quality.model_fields, *ImageQuality.model_fields, *METRICS, "pred"}
    assert fields - {"psnr", "ssim", "lpips"} == registry.RESERVED


@pytest.mark.slow
def test_a_metric_of_another_package_is_in_runs_and_reports(site: Path, msb: Msb, tmp_path: Path) -> None:
    file = make_protocol(tmp_path, ("two_dts",), keys='conditions = ["dedicated", "standard"]')
    file.path.write_bytes(file.text)
    where = {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    msb("run", "--jobs", "2", file.path, status=0, **where)
    records = {
        path.parent.name: json.loads(path.read_text())["quality"]
        for path in file.results.rglob("result.json")
    }
    for quality in records.values():
        values = [image["edges"] for image in quality["images"]]
        assert quality["edges"] == pytest.approx(math.fsum(values) / len(values))
    # A record that is older than the metric can also be read.
    write(file.results, make_result("mipnerf360", "garden", "two_dts", "standard"))
    report = tmp_path / "report"
    msb("report", "--allow-mixed", "-o", report, file.results, status=0, **where)
    tables = {path.stem: path.read_text() for path in report.rglob("*.csv")}
    loss = records["standard"]["edges"] - records["dedicated"]["edges"]
    (row,) = (line for line in tables["gaps-nerf_synthetic"].splitlines() if line.startswith("Edges ↓,2DTS"))
    assert f"{loss:.4f}," in row
    assert "Edges ↓" in tables["renderer_comparison-nerf_synthetic"]
    assert ">Edges" in (report / "verdict-nerf_synthetic-pebble-two_dts.html").read_text()
    shutil.rmtree(file.results / "cells" / "mipnerf360")
    # Without the package the records are read without the values of its metric.
    msb("report", "-o", tmp_path / "without", file.results, status=0)
    assert "Edges ↓" not in (tmp_path / "without" / "index.html").read_text()
    # If the metric raises an error, runs and comparisons continue with one warning.
    code = (site / "msb_edges.py").read_text()
    (site / "msb_edges.py").write_text(code.replace(*FAILS))
    again = msb("run", "--redo", file.path, status=0, **where)
    assert again.err.count("METRIC_FAILED: ") == 1
    qualities = [read_result(path).quality for path in file.results.rglob("result.json")]
    assert all(quality is not None and quality.values["psnr"] and quality.missing for quality in qualities)
    compared = msb("eval", "--json", "-", PRED, GT, status=0, **where)
    assert {image["edges"] for image in compared.json["images"]} == {None}
    assert compared.err.count("METRIC_FAILED: ") == 1


def test_a_record_with_a_metric_that_is_not_installed_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, make_result("mipnerf360", "garden", "two_dts", "standard"))
    data = json.loads(path.read_text())
    data["quality"]["edges"] = 0.5
    data["quality"]["metrics"].append({"name": "edges", "version": 1})
    for image in data["quality"]["images"]:
        image["edges"] = 0.5
    path.write_text(json.dumps(data))
    (note,) = read_results(tmp_path).notes
    assert "edges" in note
    data["quality"]["metrics"].pop()
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match="RECORD_INVALID"):
        read_results(tmp_path)
