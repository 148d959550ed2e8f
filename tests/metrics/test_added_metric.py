"""An image metric is one module and one line: that of CONTRIBUTING.md in a copy of the package."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.bench.protocols import protocol
from tests.conftest import ROOT
from tests.report.factory import make_result, write
from tests.test_docs_commands import blocks

GOLDEN = ROOT / "tests" / "golden" / "metrics"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of `msb` that has the metric."""
    folder = tmp_path_factory.mktemp("package")
    shutil.copytree(ROOT / "msb", folder / "msb", ignore=shutil.ignore_patterns("web"))  # compiled already
    (text,) = (block for block in blocks("CONTRIBUTING.md", "python") if "ImageMetric(" in block)
    (folder / "msb" / "metrics" / "mae.py").write_text(text)
    registry = folder / "msb" / "metrics" / "registry.py"
    before = registry.read_text()
    after = before.replace('    "perceptual.LPIPS",\n', '    "perceptual.LPIPS",\n    "mae.MAE",\n')
    assert after != before
    registry.write_text(after)
    return folder


def run(package: Path, *words: object) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "msb", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=package,
        env={**os.environ, "PYTHONPATH": str(package)},
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_eval_measures_an_added_metric(package: Path) -> None:
    out = run(package, "eval", "--json", "here.json", "--csv", "here.csv", GOLDEN / "pred", GOLDEN / "gt")
    assert out.splitlines()[0].split() == ["Image", "Size", "PSNR", "SSIM", "LPIPS", "MAE"]
    data = json.loads((package / "here.json").read_text())
    values = [image["mae"] for image in data["images"]]
    assert values[0] > 0 == values[2]
    assert data["mean"]["mae"] == pytest.approx(math.fsum(values) / 3)
    assert [one["name"] for one in data["metrics"]] == ["psnr", "ssim", "mae"]
    assert (package / "here.csv").read_text().splitlines()[0].endswith("psnr,ssim,lpips,mae")


@pytest.mark.slow
def test_records_gaps_and_tables_hold_an_added_metric(package: Path, tmp_path: Path) -> None:
    file = protocol(tmp_path, ("two_dts",), each='conditions = ["dedicated", "standard"]')
    file.path.write_bytes(file.text)
    assert re.search(r"PSNR +SSIM +LPIPS +MAE +FPS", run(package, "run", file.path))
    records: dict[str, dict[str, Any]] = {
        path.parent.name: json.loads(path.read_text())["quality"]
        for path in file.results.rglob("result.json")
    }
    for quality in records.values():
        values = [image["mae"] for image in quality["images"]]
        assert quality["mae"] == pytest.approx(math.fsum(values) / len(values))
        assert [one["name"] for one in quality["metrics"]] == ["psnr", "ssim", "mae"]
    # A record of before the metric is read beside them.
    write(file.results, make_result("mipnerf360", "garden", "two_dts", "standard"))
    run(package, "report", "--allow-mixed", "--out", tmp_path / "report", file.results)
    tables = {path.stem: path.read_text() for path in (tmp_path / "report").rglob("*.csv")}
    loss = records["standard"]["mae"] - records["dedicated"]["mae"]
    (row,) = (line for line in tables["gaps-nerf_synthetic"].splitlines() if line.startswith("MAE ↓,2DTS"))
    assert f",{loss:.4f}," in row
    assert "MAE ↓" in tables["renderer_comparison-nerf_synthetic"]
    assert ">MAE" in (tmp_path / "report" / "verdict-nerf_synthetic-pebble-two_dts.html").read_text()
