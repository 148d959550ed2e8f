"""A protocol's walk: on record and in the report."""

from pathlib import Path

import pytest

from msb.bench.folder import Results
from msb.bench.records import read_result
from msb.bench.run import run_protocol
from msb.report.build import build_report
from msb.report.pages import report_files
from msb.report.results import read_results
from tests.bench.protocols import protocol

pytestmark = pytest.mark.slow

EACH = 'conditions = ["dedicated", "standard"]'
TAIL = '[walk]\nframes = 6\nsize = 64\n[[variants]]\nlabel = "engine"\nsampling = "engine"'


def test_a_walk_is_on_record_and_in_the_report_and_is_made_once(tmp_path: Path) -> None:
    file = protocol(tmp_path, ("mesh_splatting",), each=EACH, tail=TAIL)
    assert run_protocol(file).exit_status == 0
    paths = Results(file.results).records()
    assert [path.parent.name for path in paths] == ["dedicated", "engine", "standard"]
    for path in paths:
        record = read_result(path).walk
        assert record is not None
        assert (record.frames, max(record.width, record.height), record.film) == (6, 64, "walk.mp4")
        assert 0 < record.flicker == pytest.approx(record.flicker_worst), "all of it is within a second"
        assert 0 <= record.holes < 0.02
        assert (path.parent / "walk.mp4").stat().st_size > 1000
    assert {row.planned.status for row in run_protocol(file).rows} == {"done"}
    longer = protocol(tmp_path, ("mesh_splatting",), each=EACH, tail=TAIL.replace("6", "7", 1))
    for row in run_protocol(longer).rows:
        assert row.planned.why == {"walk": "flight changed"}
    chosen = TAIL.replace("6", "8", 1).replace("size", 'conditions = ["engine"]\nsize', 1)
    rows = run_protocol(protocol(tmp_path, ("mesh_splatting",), each=EACH, tail=chosen), dry=True).rows
    assert [row.planned.cell.variant for row in rows if row.planned.why] == ["engine"]

    report = build_report(read_results(file.results))
    (table,) = next(section for section in report.sections if section.name == "walk").tables
    assert [row.labels[0] for row in table.rows] == ["Dedicated", "Dedicated, engine", "Standard"]
    assert any(one.kind == "walk" for one in report.findings)
    (page,) = [data.decode() for name, data in report_files(report).items() if name.startswith("verdict-")]
    assert page.partition("Off the path")[2].count("data:video/mp4") == 3
