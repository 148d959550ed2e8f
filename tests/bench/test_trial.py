"""A protocol's trials and repairs: in the records of exported meshes, with pictures, computed once."""

from pathlib import Path

import pytest

from msb.bench.folder import Results
from msb.bench.records import read_result
from msb.bench.run import run_protocol
from msb.report.build import build_report
from msb.report.pages import report_files
from msb.report.results import read_results
from tests.bench.protocols import protocol

EACH = 'conditions = ["exported_mesh"]'


@pytest.mark.slow
def test_trials_are_on_record_and_on_the_page_and_are_made_once(tmp_path: Path) -> None:
    tail = '[trial]\ntasks = ["self_intersections"]\ncompare = true'
    file = protocol(tmp_path, ("mesh_splatting",), each=EACH, tail=tail)
    first = run_protocol(file)
    assert first.exit_status == 0
    (path,) = Results(file.results).records()
    record = read_result(path)
    (one,) = record.trial.trials
    assert (one.task, one.picture) == ("self_intersections", "self_intersections.png")
    assert record.trial.cameras["from"] == "given"
    assert (path.parent / "trial" / one.picture).read_bytes().startswith(b"\x89PNG")
    stored, repaired = record.repairs.made[:2]
    assert (stored.strategy, repaired.trials) == ("as stored", {"self_intersections": "works"})
    assert (path.parent / "repairs" / str(repaired.picture)).read_bytes().startswith(b"\x89PNG")
    (again,) = run_protocol(file).rows
    assert again.planned.status == "done"
    (changed,) = run_protocol(
        protocol(tmp_path, ("mesh_splatting",), each=EACH, tail=f"{tail}\nseconds = 50")
    ).rows
    assert changed.planned.why == {"trial": "limits changed", "repairs": "limits changed"}
    report = build_report(read_results(file.results))
    (tried,) = report.verdicts[0].tried
    assert tried.to_dict() == report.to_dict()["verdicts"][0]["tried"][0]
    pages = [data.decode() for name, data in report_files(report).items() if name.startswith("verdict-")]
    assert "data:image/png;base64," in pages[0]
