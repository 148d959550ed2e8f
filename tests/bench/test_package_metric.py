"""An image metric of another package in `msb eval`, runs, records and reports."""

import json
import math
import os
import shutil
from pathlib import Path

import pytest

from msb.bench.aggregate import METRICS
from msb.bench.records import ImageQuality, Quality, read_result
from msb.errors import InputError
from msb.metrics import registry
from msb.report.results import read_results
from tests.bench.protocols import protocol
from tests.cli.conftest import Msb
from tests.conftest import ROOT
from tests.metrics.conftest import GOLDEN
from tests.report.factory import make_result, write
from tests.test_docs_commands import installed

FAILS = ("    steps = [", "    1 / 0\n    steps = [")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return installed("docs/extending.md", tmp_path / "site")


def test_no_metric_may_have_the_key_of_something_else() -> None:
    fields = {*Quality.model_fields, *ImageQuality.model_fields, *METRICS, "pred"}
    assert fields - {"psnr", "ssim", "lpips"} == registry.RESERVED


@pytest.mark.slow
def test_runs_and_reports_have_it(site: Path, msb: Msb, tmp_path: Path) -> None:
    file = protocol(tmp_path, ("two_dts",), each='conditions = ["dedicated", "standard"]')
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
    # A record of before the metric is read beside them.
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
    # Without the package the records are read, and its values are left out.
    msb("report", "-o", tmp_path / "without", file.results, status=0)
    assert "Edges ↓" not in (tmp_path / "without" / "index.html").read_text()
    # With a broken one runs and comparisons go on, and say so once.
    code = (site / "msb_edges.py").read_text()
    (site / "msb_edges.py").write_text(code.replace(*FAILS))
    again = msb("run", "--redo", file.path, status=0, **where)
    assert again.err.count("METRIC_FAILED: ") == 1
    held = [read_result(path).quality for path in file.results.rglob("result.json")]
    assert all(quality is not None and quality.values["psnr"] and quality.missing for quality in held)
    found = msb("eval", "--json", "-", GOLDEN / "pred", GOLDEN / "gt", status=0, **where)
    assert {image["edges"] for image in found.json["images"]} == {None}
    assert found.err.count("METRIC_FAILED: ") == 1


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
