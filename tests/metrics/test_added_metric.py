"""An image metric is added by one module and one line: the example of CONTRIBUTING.md, in a copy of `msb`."""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.test_docs_commands import blocks

GOLDEN = ROOT / "tests" / "golden" / "metrics"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of `msb` that includes the metric."""
    folder = tmp_path_factory.mktemp("package")
    shutil.copytree(ROOT / "msb", folder / "msb", ignore=shutil.ignore_patterns("web"))  # already compiled
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
    assert [metric["name"] for metric in data["metrics"]] == ["psnr", "ssim", "mae"]
    assert (package / "here.csv").read_text().splitlines()[0].endswith("psnr,ssim,lpips,mae")
