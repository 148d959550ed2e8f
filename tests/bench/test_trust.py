"""Ground truth, renderings and records in the results folder are verified before they are used."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PIL import Image

from msb.bench.folder import lock_results
from msb.bench.photographs import HASHES, PhotographTask, describe_views, write_photographs
from msb.bench.protocol import ProtocolFile
from msb.bench.run import run_protocol
from msb.errors import InputError, MsbError
from msb.report.build import build_report
from msb.report.results import read_results
from msb.scenes.datasets import SceneAt
from tests.bench.protocols import STUBS, Notes, get_plan, read_cell

CELLS = "cells/nerf_synthetic/pebble"


def invert(path: Path) -> None:
    """Replace an image by its negative."""
    with Image.open(path) as picture:
        negative = picture.convert("RGB").point(lambda value: 255 - value)
    negative.save(path)


def edit(path: Path, *keys: str, value: object) -> None:
    """Replace the value at nested keys of a JSON file."""
    data = json.loads(path.read_text())
    *outer, last = keys
    place = data
    for name in outer:
        place = place[name]
    place[last] = value
    path.write_text(json.dumps(data))


@pytest.fixture
def task(tmp_path: Path) -> Iterator[PhotographTask]:
    """The task of a scene whose ground truth has been written."""
    path = STUBS / "scenes" / "nerf_synthetic" / "pebble"
    at = SceneAt("nerf_synthetic", "pebble", path, None, None, (1.0, 1.0, 1.0), "gs_fov")
    with lock_results(tmp_path) as run:
        order = PhotographTask(tmp_path, run, at, describe_views(at.read()))
        assert write_photographs(order) is None
        yield order


DAMAGE: dict[str, Callable[[Path], object]] = {
    "edited": lambda at: invert(at / "test/r_0.png"),
    "truncated": lambda at: (at / "test/r_1.png").write_bytes(b"\x89PNG"),
    "a folder": lambda at: [(at / "test/r_1.png").unlink(), (at / "test/r_1.png").mkdir()],
    "additional file": lambda at: shutil.copy(at / "test/r_0.png", at / "x.png"),
    "no list": lambda at: (at / HASHES).unlink(),
    "damaged list": lambda at: (at / HASHES).write_bytes(b"{"),
    "list of other photographs": lambda at: edit(at / HASHES, "photographs", value="0" * 16),
    "shorter list": lambda at: [(at / "test/r_0.png").unlink(), edit(at / HASHES, "files", value={})],
    "no images": lambda at: shutil.rmtree(at / "test"),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_ground_truth_is_written_again(task: PhotographTask, damage: str) -> None:
    before = {path: path.read_bytes() for path in task.folder.rglob("*") if path.is_file()}
    assert len(before) == 5
    DAMAGE[damage](task.folder)
    assert write_photographs(task)
    assert {path: path.read_bytes() for path in task.folder.rglob("*") if path.is_file()} == before
    times = {path: path.stat().st_mtime_ns for path in before}
    assert write_photographs(task) is None
    assert {path: path.stat().st_mtime_ns for path in before} == times, "valid files are not written again"


@pytest.mark.slow
def test_edited_photographs_do_not_change_results(again: ProtocolFile) -> None:
    before = read_cell(again, "two_dts/standard").quality
    for path in (again.results / "ground_truth").rglob("*.png"):
        invert(path)
    run_protocol(again, only=["two_dts/standard"], redo=True)
    assert read_cell(again, "two_dts/standard").quality == before
    (path, *_) = (again.results / "ground_truth").rglob("*.png")
    content = path.read_bytes()
    path.write_bytes(content[:-100])
    assert set(get_plan(run_protocol(again, only=["two_dts/dedicated"])).values()) == {"done"}
    assert path.read_bytes() == content, "verified even if all cells are done"


@pytest.mark.slow
def test_invalid_records_and_renderings_are_computed_again(
    again: ProtocolFile,
) -> None:
    here = again.results / CELLS
    names = [f"two_dts/{name}" for name in ("non_engine", "dedicated", "standard")]
    names += [f"diffsoup/{name}" for name in ("non_engine", "dedicated")]
    before = {name: read_cell(again, name) for name in names}
    invert(here / "two_dts/non_engine/images/test/r_1.png")
    (here / "two_dts/dedicated/images/test/r_2.png").unlink()
    shutil.rmtree(here / "two_dts/standard/images")
    edit(here / "diffsoup/dedicated/result.json", "cell", "method", value="two_dts")
    edit(here / "diffsoup/non_engine/result.json", "quality", "psnr", value=-3.0)
    expected = {
        "two_dts/non_engine": {"quality"},
        "two_dts/dedicated": {"quality"},
        "two_dts/standard": {"quality"},
        "diffsoup/dedicated": {"quality", "timing"},
    }
    watch = Notes()
    plan = get_plan(run_protocol(again, jobs=2, watch=watch))
    assert {name: set(plan[name]) for name in expected} == expected
    codes = [line.split(": ")[1] for line in watch.lines if "result.json" in line]
    assert codes == ["RECORD_INVALID", "RECORD_INVALID"]
    assert plan["two_dts/exported_mesh"] == "done"
    for name, record in before.items():
        now = read_cell(again, name)
        assert (now.cell, now.quality, now.setup) == (record.cell, record.quality, record.setup)
    assert set(get_plan(run_protocol(again, dry=True)).values()) == {"done", "unsupported"}


def test_a_report_rejects_a_record_in_the_wrong_folder(again: ProtocolFile) -> None:
    path = again.results / CELLS / "two_dts/dedicated/result.json"
    edit(path, "cell", "method", value="mesh_splatting")
    with pytest.raises(InputError, match="RECORD_INVALID") as caught:
        read_results(again.results)
    assert caught.value.file == str(path)
    path.parent.rename(path.parent.with_name("standard_of_before"))
    with pytest.raises(MsbError, match="RECORD_INVALID"):
        read_results(again.results)


@pytest.mark.slow
def test_a_report_names_missing_and_changed_renderings(again: ProtocolFile) -> None:
    here = again.results / CELLS / "two_dts"
    gone = here / "dedicated/images/test/r_0.png"
    for path in gone.parent.iterdir():
        path.unlink()
    for path in (here / "standard/images/test").iterdir():
        invert(path)
    report = build_report(read_results(again.results))
    assert any(str(gone) in note for note in report.notes)
    assert any(str(here / "standard/images/test") in note for note in report.notes)
    (section,) = [section for section in report.sections if section.name == "looks"]
    shots = {shot.heading: shot for shot in section.views[0].renderings["two_dts"]}
    assert {name: shot.image is None for name, shot in shots.items()} == {
        "Non-Engine": False,
        "Dedicated": True,
        "Standard": True,
    }
