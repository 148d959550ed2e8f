"""`msb report` as its users meet it."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from msb.bench.records import File
from msb.report.pages import report_files
from msb.report.report import Report
from tests.cli.conftest import Msb
from tests.report.factory import make_result, write, write_results


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_results(tmp_path_factory.mktemp("run"), datasets=["tanksandtemples"], images=True)


@pytest.mark.slow
def test_report_is_written_whole_and_replaces_itself_but_nothing_put_into_it(msb: Msb, folder: Path) -> None:
    done = msb("report", folder, status=0)
    assert done.out.startswith("32 results ")
    assert done.out.splitlines()[-1] == str(folder / "report" / "index.html")
    assert (folder / "report" / "tables" / "native_summary.tex").is_file()
    assert (folder / "report" / "verdict-tanksandtemples-train-two_dts.html").is_file()
    data = msb("report", "--format", "tex", "--json", "-", folder, status=0).json
    assert (data["schema"], len(data["verdicts"])) == ("msb.report/1", 8)
    assert "tables/native_summary.tex" in data["files"]
    assert not (folder / "report" / "index.html").exists()
    (folder / "report" / "mine.txt").write_text("a page of notes")
    msb("report", "-f", "-q", "--format", "csv", folder, status=0)
    assert (folder / "report" / "mine.txt").exists()
    msb("report", "-f", "-o", folder, folder).ends(2, "USAGE: ")
    msb("report", "-f", "-o", folder.parent, folder).ends(2, "OUTPUT_EXISTS: ")


@pytest.mark.slow
def test_one_table_is_printed(msb: Msb, folder: Path) -> None:
    done = msb("report", "--table", "renderer_comparison-tanksandtemples", folder, status=0)
    assert done.out.startswith("**Tanks and Temples: ")
    assert re.search(r"^\| Standard \| .*PSNR ↑ \|", done.out, re.MULTILINE)
    data = msb("report", "--table", "slowdown", "--json", "-", folder).json
    assert data["schema"] == "msb.table/1"
    as_csv = msb("report", "--table", "slowdown", "--format", "csv", folder).out
    assert as_csv.splitlines()[0].endswith(",Source")
    assert as_csv.count("\n") == as_csv.rstrip().count("\n") + 1  # a file of its own, if it is sent to one
    for formats in ("tex,csv", "html"):
        assert msb("report", "--table", "slowdown", "--format", formats, folder).err.startswith("USAGE: ")
    msb("report --table nonsense", folder).ends(2, "NAME_UNKNOWN: ")
    msb("report", "--table", "slowdown", "--view", "train/none.png", folder).ends(2, "USAGE: ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "code"),
    [
        (["--paper", "x"], "USAGE"),
        (["--paper", "--published", "nothere.json"], "USAGE"),
        (["--paper", "--view", "garden/a.png"], "USAGE"),
        (["--paper", "--against", "diffsoup"], "USAGE"),
        (["--paper", "--no-paper"], "USAGE"),
        ([], "USAGE"),
        (["--format", "pdf", "--paper"], "USAGE"),
        (["nowhere"], "FILE_NOT_FOUND"),
        (["README.md"], "FILE_UNREADABLE"),
        (["docs"], "RESULTS_EMPTY"),
    ],
)
def test_what_cannot_be_done_is_one_line(msb: Msb, args: list[str], code: str) -> None:
    msb("report", *args).ends(2 if "USAGE" in code else 3, code)


@pytest.mark.slow
def test_topology_is_drawn_of_the_asset_that_was_audited(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="extra view is not installed")
    import msb as library

    about = File(path=str(demo_asset), bytes=demo_asset.stat().st_size)
    audit = library.audit(library.load(demo_asset)).to_dict()
    assert audit["verdict"]["level"] == "bad"
    made = make_result("capture", "desk", "mesh_splatting", "exported_mesh")
    made = made.model_copy(update={"asset": about})
    write(tmp_path, made, audit=audit)
    done = msb("report", "--format", "html", tmp_path, status=0)
    if "VIEW_NO_DISPLAY" in done.err:
        pytest.skip("there is nothing to draw with here")
    page = (tmp_path / "report" / "verdict-capture-desk-mesh_splatting.html").read_text()
    assert "data:image/png;base64," in page
    assert audit["verdict"]["sentence"][1:40] in page
    audit["counts"]["faces"] += 1
    write(tmp_path, made, audit=audit)
    done = msb("report", "-f", "--format", "html", tmp_path, status=0)
    assert done.err.count("\n") == 1
    page = (tmp_path / "report" / "verdict-capture-desk-mesh_splatting.html").read_text()
    assert "data:image/png;base64," not in page


@pytest.mark.slow
def test_sorting_works_in_a_browser(report: Report, in_browser: Callable[..., Any]) -> None:
    page = report_files(report, formats=["html"])["index.html"]
    # The first button of the summary is pressed.
    press = """
    const table = document.querySelector('#native_summary table'), rows = () =>
      [...table.querySelectorAll('tbody tr:not(.group):not(.paper)')]
        .map((row) => row.cells[1].dataset.value);
    const button = table.querySelector('thead button'); button.click(); const down = rows(); button.click();
    const pairs = [...table.querySelectorAll('tr.paper')].every((row) =>
      !row.previousElementSibling.classList.contains('paper'));
    return [down, rows(), pairs];
    """
    down, up, pairs = in_browser(page, press)
    values = list(map(float, down))
    assert len(values) == 4
    assert values == sorted(values, reverse=True)
    assert up == down[::-1]
    assert pairs
