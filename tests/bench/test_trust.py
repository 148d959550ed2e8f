"""Nothing in the results folder is taken on trust: copies, renderings, records are as they were written."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from msb.bench.folder import exclusive
from msb.bench.photographs import HASHES, PhotographTask, views_of, write_photographs
from msb.bench.protocol import ProtocolFile
from msb.bench.run import run_protocol
from msb.errors import InputError, MsbError
from msb.report.build import build_report
from msb.report.results import read_results
from msb.scenes.datasets import SceneAt
from tests.bench.protocols import STUBS, Notes, cell, planned

CELLS = "cells/nerf_synthetic/pebble"


def invert(path: Path) -> None:
    """Make another picture of the same size of it."""
    with Image.open(path) as picture:
        other = picture.convert("RGB").point(lambda value: 255 - value)
    other.save(path)


def edit(path: Path, **changes: Any) -> None:
    """Replace keys of a JSON file; a__b is b in a."""
    data = json.loads(path.read_text())
    for key, value in changes.items():
        *above, last = key.split("__")
        place = data
        for name in above:
            place = place[name]
        place[last] = value
    path.write_text(json.dumps(data))


@pytest.fixture
def task(tmp_path: Path) -> Iterator[PhotographTask]:
    """Ground truth that has been written."""
    path = STUBS / "scenes" / "nerf_synthetic" / "pebble"
    at = SceneAt("nerf_synthetic", "pebble", path, None, None, (1.0, 1.0, 1.0), "gs_fov")
    with exclusive(tmp_path) as run:
        made = PhotographTask(tmp_path, run, at, views_of(at.read()))
        assert write_photographs(made) is None
        yield made


DAMAGE: dict[str, Callable[[Path], object]] = {
    "edited": lambda at: invert(at / "test/r_0.png"),
    "truncated": lambda at: (at / "test/r_1.png").write_bytes(b"\x89PNG"),
    "a folder": lambda at: [(at / "test/r_1.png").unlink(), (at / "test/r_1.png").mkdir()],
    "one too many": lambda at: shutil.copy(at / "test/r_0.png", at / "x.png"),
    "list gone": lambda at: (at / HASHES).unlink(),
    "list damaged": lambda at: (at / HASHES).write_bytes(b"{"),
    "list of others": lambda at: edit(at / HASHES, photographs="0" * 16),
    "list of fewer": lambda at: [(at / "test/r_0.png").unlink(), edit(at / HASHES, files={})],
    "all gone": lambda at: shutil.rmtree(at / "test"),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGE)
def test_ground_truth_that_is_not_as_it_was_written_is_written_again(
    task: PhotographTask, damage: str
) -> None:
    before = {path: path.read_bytes() for path in task.folder.rglob("*") if path.is_file()}
    assert len(before) == 5
    DAMAGE[damage](task.folder)
    assert write_photographs(task)
    assert {path: path.read_bytes() for path in task.folder.rglob("*") if path.is_file()} == before
    times = {path: path.stat().st_mtime_ns for path in before}
    assert write_photographs(task) is None
    assert {path: path.stat().st_mtime_ns for path in before} == times, "what holds is left alone"


@pytest.mark.slow
def test_no_number_stands_on_an_edited_photograph(again: ProtocolFile) -> None:
    before = cell(again, "two_dts/standard").quality
    for path in (again.results / "ground_truth").rglob("*.png"):
        invert(path)
    found = run_protocol(again, only=["two_dts/standard"], redo=True)
    assert planned(found) == {"two_dts/standard": {"quality": "asked for", "timing": "asked for"}}
    assert cell(again, "two_dts/standard").quality == before
    (path, *_) = (again.results / "ground_truth").rglob("*.png")
    right = path.read_bytes()
    path.write_bytes(right[:-100])
    assert set(planned(run_protocol(again, only=["two_dts/dedicated"])).values()) == {"done"}
    assert path.read_bytes() == right, "also where all cells are done"


@pytest.mark.slow
def test_what_is_wrong_with_a_record_or_a_rendering_is_said_and_the_cell_done_again(
    again: ProtocolFile,
) -> None:
    here = again.results / CELLS
    names = [f"two_dts/{name}" for name in ("non_engine", "dedicated", "standard")]
    names += [f"diffsoup/{name}" for name in ("non_engine", "dedicated")]
    before = {name: cell(again, name) for name in names}
    invert(here / "two_dts/non_engine/images/test/r_1.png")
    (here / "two_dts/dedicated/images/test/r_2.png").unlink()
    shutil.rmtree(here / "two_dts/standard/images")
    edit(here / "diffsoup/dedicated/result.json", cell__method="two_dts")
    edit(here / "diffsoup/non_engine/result.json", quality__psnr=-3.0)
    wrong = {
        "two_dts/non_engine": {"quality"},
        "two_dts/dedicated": {"quality"},
        "two_dts/standard": {"quality"},
        "diffsoup/dedicated": {"quality", "timing"},
    }
    watch = Notes()
    told = planned(run_protocol(again, jobs=2, watch=watch))
    assert {name: set(told[name]) for name in wrong} == wrong
    assert [text.split(": ")[1] for text in watch.said if "result.json" in text] == [
        "RECORD_INVALID",
        "RECORD_INVALID",
    ]
    assert told["two_dts/exported_mesh"] == "done"
    for name, record in before.items():
        now = cell(again, name)
        assert (now.cell, now.quality, now.setup) == (record.cell, record.quality, record.setup)
    assert set(planned(run_protocol(again, dry=True)).values()) == {"done", "unsupported"}


def test_a_report_refuses_a_record_in_the_place_of_another(again: ProtocolFile) -> None:
    path = again.results / CELLS / "two_dts/dedicated/result.json"
    edit(path, cell__method="mesh_splatting")
    with pytest.raises(InputError, match="RECORD_INVALID") as caught:
        read_results(again.results)
    assert caught.value.file == str(path)
    path.parent.rename(path.parent.with_name("standard_of_before"))
    with pytest.raises(MsbError, match="RECORD_INVALID"):
        read_results(again.results)


@pytest.mark.slow
def test_a_report_names_renderings_it_cannot_show(again: ProtocolFile) -> None:
    here = again.results / CELLS / "two_dts"
    gone = here / "dedicated/images/test/r_0.png"
    for path in gone.parent.iterdir():
        path.unlink()
    for path in (here / "standard/images/test").iterdir():
        invert(path)
    made = build_report(read_results(again.results))
    assert any(str(gone) in note for note in made.notes)
    assert any(str(here / "standard/images/test") in note for note in made.notes)
    (section,) = [section for section in made.sections if section.name == "looks"]
    shots = {shot.heading: shot for shot in section.views[0].shots["two_dts"]}
    assert {name: shot.picture is None for name, shot in shots.items()} == {
        "Non-Engine": False,
        "Dedicated": True,
        "Standard": True,
    }
