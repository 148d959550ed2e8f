"""An image metric in another package: that of docs/extending.md, failing, broken, and not installed."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.base.packages import PackageWarning
from msb.bench.aggregate import METRICS as ALL_METRICS
from msb.bench.records import ImageQuality, Quality, read_result
from msb.errors import InputError
from msb.metrics import IMAGE_METRICS, METRICS, Measures, registry
from msb.report.results import read_results
from tests.bench.protocols import protocol
from tests.cli.conftest import Msb, msb
from tests.conftest import ROOT
from tests.report.factory import make_result, write
from tests.test_docs_commands import installed

__all__ = ["msb"]
GOLDEN = ROOT / "tests" / "golden" / "metrics"
OURS = ["psnr", "ssim", "lpips"]
BLACK, WHITE = np.zeros((4, 4, 3)), np.ones((4, 4, 3))


def forget() -> None:
    registry._installed.cache_clear()
    sys.modules.pop("msb_edges", None)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return installed("docs/extending.md", tmp_path / "site")


@pytest.fixture
def edit(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Install the metric with a part of its text, or of its entry point, replaced."""
    monkeypatch.syspath_prepend(site)

    def change(old: str = "", new: str = "", entry: str = "edges = msb_edges:EDGES") -> None:
        file = site / "msb_edges.py"
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new) if old else text)
        (site / "msb_edges-1.0.dist-info" / "entry_points.txt").write_text(f"[msb.metrics]\n{entry}\n")
        forget()

    yield change
    monkeypatch.undo()
    forget()


def test_it_is_one_of_the_metrics(edit: Callable[..., None]) -> None:
    edit()
    assert list(IMAGE_METRICS) == [*OURS, "edges"]
    assert METRICS["edges"] == "lower"
    measures = Measures()
    assert measures(BLACK, BLACK)["edges"] == 0
    ramp = np.linspace(0, 255, 4).round()[:, None, None] / 255 * np.ones((4, 4, 3))
    assert measures(ramp, BLACK)["edges"] == pytest.approx(1 / 6)
    assert measures.identities[-1].to_dict()["libraries"]["msb-edges"] == "1.0"
    assert measures.failed == {}


FAILING = {
    "raise SystemExit": "fails: SystemExit",
    "raise KeyboardInterrupt": "fails: KeyboardInterrupt",
    "return 1 / 0": "fails: ZeroDivisionError: division by zero",
    "return float('nan')": "gives nan; it must give a finite number",
    "return np.inf": "gives inf; it must give a finite number",
    "return '0.5'": "gives '0.5'; it must give a finite number",
    "return None": "fails: TypeError",
    "return rendering": "fails: TypeError",
}


@pytest.mark.parametrize(("text", "why"), FAILING.items())
def test_one_that_fails_has_no_value_and_says_whose_it_is(
    edit: Callable[..., None], text: str, why: str
) -> None:
    edit("    steps = [", f"    {text}\n    steps = [")
    measures = Measures()
    found = measures(WHITE, BLACK)
    assert (found["psnr"], found["edges"]) == (0, None)
    assert measures.failed["edges"].startswith(f"METRIC_FAILED: metric edges of package msb_edges {why}")


def test_one_that_prints_and_changes_its_images_changes_nothing(
    edit: Callable[..., None], capfd: pytest.CaptureFixture[str]
) -> None:
    edit("    steps = [", "    print('hello')\n    rendering[:] = 1\n    steps = [")
    image = WHITE * 0.2
    assert Measures()(image, BLACK)["edges"] == 0
    assert image.max() == 0.2
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("old", "new", "entry", "why"),
    [
        ("import numpy as np", "import sys; sys.exit()", None, "it cannot be loaded: SystemExit"),
        ("EDGES = ", "EDGES = 3\nOTHER = ", None, "it is no ImageMetric, but of type int"),
        ("", "", "psnr = msb_edges:EDGES", "the name is taken by msb.metrics"),
        ("", "", "fps = msb_edges:EDGES", "something else in records or tables"),
        ("", "", "corners = msb_edges:EDGES", "must be that of its entry point, corners"),
        ("", "", "edges =", "names no module"),
        ("decimals=4", "decimals='4'", None, "its decimals is of type str"),
        ("measure=edges", "measure=None", None, "its measure is of type NoneType"),
        ('better="lower"', 'better="less"', None, "its better is 'less'"),
    ],
)
def test_one_that_is_none_is_one_warning(
    edit: Callable[..., None], old: str, new: str, entry: str | None, why: str
) -> None:
    edit(old, new, **({} if entry is None else {"entry": entry}))
    with pytest.warns(PackageWarning, match=f"^PACKAGE_LEFT_OUT: .*{why}") as caught:
        assert list(IMAGE_METRICS) == OURS
    assert len(caught) == 1


def test_no_metric_may_have_the_key_of_something_else() -> None:
    fields = {*Quality.model_fields, *ImageQuality.model_fields, *ALL_METRICS, "pred"}
    assert fields - {*OURS} == registry.RESERVED


@pytest.mark.slow
def test_a_command_that_measures_nothing_does_not_import_it(site: Path, msb: Msb, demo_asset: Path) -> None:
    (site / "msb_edges.py").write_text("raise SystemExit(3)\n")
    where = {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    for words in (("audit", demo_asset), ("methods",), ("validate", demo_asset)):
        found = msb(*words, **where)
        assert (found.status, found.err) == (0, "")


@pytest.mark.slow
def test_eval_says_once_that_it_fails(site: Path, msb: Msb) -> None:
    file = site / "msb_edges.py"
    file.write_text(file.read_text().replace("    steps = [", "    1 / 0\n    steps = ["))
    where = {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    found = msb("eval", "--json", "-", GOLDEN / "pred", GOLDEN / "gt", **where)
    assert found.status == 0
    assert [image["edges"] for image in found.json["images"]] == [None] * len(found.json["images"])
    (line,) = (line for line in found.err.splitlines() if "edges" in line)
    assert line.startswith(
        "warning: METRIC_FAILED: metric edges of package msb_edges fails: ZeroDivisionError"
    )


@pytest.mark.slow
def test_runs_and_reports_have_it(site: Path, msb: Msb, tmp_path: Path) -> None:
    file = protocol(tmp_path, ("two_dts",), each='conditions = ["dedicated", "standard"]')
    file.path.write_bytes(file.text)
    where = {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    ran = msb("run", "--jobs", "2", file.path, **where)
    assert ran.status == 0, ran.err
    records: dict[str, Any] = {
        path.parent.name: json.loads(path.read_text())["quality"]
        for path in file.results.rglob("result.json")
    }
    for quality in records.values():
        values = [image["edges"] for image in quality["images"]]
        assert quality["edges"] == pytest.approx(math.fsum(values) / len(values))
    # A record of before the metric is read beside them.
    write(file.results, make_result("mipnerf360", "garden", "two_dts", "standard"))
    report = tmp_path / "report"
    assert msb("report", "--allow-mixed", "-o", report, file.results, **where).status == 0
    tables = {path.stem: path.read_text() for path in report.rglob("*.csv")}
    loss = records["standard"]["edges"] - records["dedicated"]["edges"]
    (row,) = (line for line in tables["gaps-nerf_synthetic"].splitlines() if line.startswith("Edges ↓,2DTS"))
    assert f"{loss:.4f}," in row
    assert "Edges ↓" in tables["renderer_comparison-nerf_synthetic"]
    assert ">Edges" in (report / "verdict-nerf_synthetic-pebble-two_dts.html").read_text()
    shutil.rmtree(file.results / "cells" / "mipnerf360")
    # Without the package the records are read, and a note says what is left out.
    without = msb("report", "-o", tmp_path / "without", file.results)
    assert without.status == 0, without.err
    pages = "".join(path.read_text() for path in (tmp_path / "without").glob("*.html"))
    assert "2 records have a metric edges, whose package is not installed here" in pages
    assert "Edges ↓" not in pages
    # With a broken one the run goes on, and says so.
    text = (site / "msb_edges.py").read_text()
    (site / "msb_edges.py").write_text(text.replace("    steps = [", "    1 / 0\n    steps = ["))
    again = msb("run", "--redo", file.path, **where)
    assert again.status == 0
    assert again.err.count("METRIC_FAILED: metric edges of package msb_edges fails") == 1
    held = [read_result(path).quality for path in file.results.rglob("result.json")]
    assert all(quality is not None and quality.values["psnr"] and quality.missing for quality in held)


def test_a_record_with_a_metric_that_is_not_installed_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, make_result("mipnerf360", "garden", "two_dts", "standard"))
    data = json.loads(path.read_text())
    data["quality"]["edges"] = 0.5
    data["quality"]["metrics"].append({"name": "edges", "version": 1})
    for image in data["quality"]["images"]:
        image["edges"] = 0.5
    path.write_text(json.dumps(data))
    assert read_results(tmp_path).notes == (
        "a record has a metric edges, whose package is not installed here: its values are left out",
    )
    data["quality"]["metrics"].pop()
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match="there is no metric 'edges'"):
        read_results(tmp_path)
