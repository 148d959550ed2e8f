"""Walks, trials and films of a protocol are recorded, shown in the report, and computed once."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from msb import metrics
from msb.bench.folder import Results
from msb.bench.protocol import ProtocolFile
from msb.bench.protocol_tables import VideosTable
from msb.bench.records import read_result
from msb.bench.run import run_protocol
from msb.report.build import build_report
from msb.report.pages import report_files
from msb.report.results import read_results
from tests.bench.protocols import change_tables, get_plan, make_protocol

pytestmark = pytest.mark.slow

KEYS = 'conditions = ["dedicated", "standard"]'
TAIL = '[walk]\nframes = 6\nsize = 64\n[[variants]]\nlabel = "engine"\nsampling = "engine"'


def test_a_walk_is_recorded_reported_and_measured_once(tmp_path: Path) -> None:
    file = make_protocol(tmp_path, ("mesh_splatting",), keys=KEYS, tail=TAIL)
    assert run_protocol(file).exit_status == 0
    paths = Results(file.results).records()
    assert [path.parent.name for path in paths] == ["dedicated", "engine", "standard"]
    for path in paths:
        record = read_result(path).walk
        assert (record.frames, max(record.width, record.height), record.film) == (6, 64, "walk.mp4")
        assert 0 < record.flicker == pytest.approx(record.flicker_worst), "the walk is shorter than a second"
        assert 0 <= record.holes < 0.02
        assert (path.parent / "walk.mp4").stat().st_size > 1000
    assert {row.planned.status for row in run_protocol(file).rows} == {"done"}
    longer = make_protocol(tmp_path, ("mesh_splatting",), keys=KEYS, tail=TAIL.replace("6", "7", 1))
    for row in run_protocol(longer).rows:
        assert row.planned.why == {"walk": "flight changed"}
    chosen = TAIL.replace("6", "8", 1).replace("size", 'conditions = ["engine"]\nsize', 1)
    rows = run_protocol(make_protocol(tmp_path, ("mesh_splatting",), keys=KEYS, tail=chosen), dry=True).rows
    assert [row.planned.cell.variant for row in rows if row.planned.why] == ["engine"]

    report = build_report(read_results(file.results))
    (table,) = next(section for section in report.sections if section.name == "walk").tables
    assert [row.labels[0] for row in table.rows] == ["Dedicated", "Dedicated, engine", "Standard"]
    assert any(finding.kind == "walk" for finding in report.findings)
    (page,) = [data.decode() for name, data in report_files(report).items() if name.startswith("verdict-")]
    assert page.partition("<h2>Away from the captured views")[2].count("data:video/mp4") == 3


MESHES = 'conditions = ["exported_mesh"]'


def test_trials_are_recorded_reported_and_run_once(tmp_path: Path) -> None:
    tail = '[trial]\ntasks = ["self_intersections"]\ncompare = true'
    file = make_protocol(tmp_path, ("mesh_splatting",), keys=MESHES, tail=tail)
    first = run_protocol(file)
    assert first.exit_status == 0
    (path,) = Results(file.results).records()
    record = read_result(path)
    (trial,) = record.trial.trials
    assert (trial.task, trial.picture) == ("self_intersections", "self_intersections.png")
    assert record.trial.cameras["from"] == "given"
    assert (path.parent / "trial" / trial.picture).read_bytes().startswith(b"\x89PNG")
    stored, repaired = record.repairs.succeeded[:2]
    assert (stored.strategy, repaired.trials) == ("as stored", {"self_intersections": "works"})
    assert (path.parent / "repairs" / str(repaired.picture)).read_bytes().startswith(b"\x89PNG")
    (again,) = run_protocol(file).rows
    assert again.planned.status == "done"
    (changed,) = run_protocol(
        make_protocol(tmp_path, ("mesh_splatting",), keys=MESHES, tail=f"{tail}\nseconds = 50")
    ).rows
    assert changed.planned.why == {"trial": "limits changed", "repairs": "limits changed"}
    report = build_report(read_results(file.results))
    (tried,) = report.verdicts[0].outcomes
    assert tried.to_dict() == report.to_dict()["verdicts"][0]["tried"][0]
    pages = [data.decode() for name, data in report_files(report).items() if name.startswith("verdict-")]
    assert "data:image/png;base64," in pages[0]


def frames(path: Path) -> list[NDArray[np.uint8]]:
    import av

    with av.open(str(path)) as film:
        return [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]


@pytest.mark.parametrize("path", ["flight", "test"])
def test_a_film_shows_conditions_side_by_side(again: ProtocolFile, path: str) -> None:
    options = VideosTable(path=path, frames=8, fps=8)
    file = change_tables(again, videos=options)
    only = ["two_dts/dedicated", "two_dts/standard"]
    assert set(get_plan(run_protocol(file, only=only)).values()) == {"done"}
    film = file.results / "videos" / "nerf_synthetic" / "pebble" / "two_dts.mp4"
    film_frames = frames(film)
    assert len(film_frames) == 8
    columns = 2 if path == "flight" else 3
    height, width = film_frames[0].shape[:2]
    assert height >= 240
    if path == "test":  # photograph, Dedicated and Standard, with whole repeated pixels
        folder = next((file.results / "ground_truth").rglob("*.png")).parent
        photograph = metrics.read_image(sorted(folder.glob("*.png"))[0])
        assert width == columns * photograph.shape[1] * (height // photograph.shape[0])
        times = height // photograph.shape[0]
        enlarged = photograph.repeat(times, axis=0).repeat(times, axis=1)
        lower = height // 3  # below the title
        seen = film_frames[0][lower:, : enlarged.shape[1]].astype(float)
        assert np.abs(seen - enlarged[lower:]).mean() < 4
    part = width // columns
    first, last = (
        film_frames[0][:, number * part : (number + 1) * part].astype(float) for number in (-2, -1 % columns)
    )
    assert np.abs(first - last).mean() > 0.5, "the conditions differ"
    assert not film.parent.with_suffix(".mp4").exists(), "one method needs no grid"
    written = film.stat().st_mtime_ns
    run_protocol(file, only=only)
    assert film.stat().st_mtime_ns == written, "a valid film is not written again"


def test_a_grid_shows_methods_below_each_other(again: ProtocolFile) -> None:
    file = change_tables(again, videos=VideosTable(frames=4, fps=4))
    only = ["two_dts/dedicated", "two_dts/standard", "diffsoup/dedicated"]
    run_protocol(file, only=only)
    grid = file.results / "videos" / "nerf_synthetic" / "pebble.mp4"
    both, single = frames(grid), frames(grid.with_suffix("") / "two_dts.mp4")
    assert len(both) == 4
    height, width = single[0].shape[:2]
    assert both[0].shape[:2] == (2 * height, width)
    two_dts, diffsoup = both[0][:height].astype(float), both[0][height:].astype(float)
    part = height * 3 // 4  # the title of the method is below
    assert np.abs(two_dts[:part] - single[0][:part]).mean() < 4
    assert diffsoup[:, : width // 2].std() > 5
    absent = diffsoup[:, width // 2 + 8 :]
    assert absent[: height // 4].max() > 150, "DiffSoup has no standard tier, and its panel says so"
    assert absent[height // 4 : part].max() < 20
    written = grid.stat().st_mtime_ns
    run_protocol(file, only=only)
    assert grid.stat().st_mtime_ns == written
