"""A dry run names all that is missing, each thing once with what it costs, and ends as the run would."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from msb.bench.protocol import example, parse_protocol
from msb.bench.run import run_protocol
from tests.bench.protocols import PEBBLE, STUBS, protocol

if TYPE_CHECKING:
    from pathlib import Path

    from msb.bench.missing import Missing
    from msb.bench.run import Report


def told(report: Report, word: str) -> Missing:
    """Return the one missing thing that the word is in."""
    (found,) = [one for one in report.missing if word in one.message]
    return found


def test_of_the_paper_in_an_empty_folder_each_dataset_and_method_is_named_once(tmp_path: Path) -> None:
    report = run_protocol(parse_protocol(example("paper"), tmp_path / "paper.toml"), dry=True)
    assert report.exit_status == 3
    assert list(tmp_path.iterdir()) == []
    assert len(report.missing) == 17
    for name, scenes in (("360_v2", 9), ("tandt", 2), ("nerf_synthetic", 8), ("data/dtu", 15)):
        one = told(report, f"{tmp_path / 'data' / name.split('/')[-1]}: ")
        assert f" on {scenes} scenes: {one.cells} cells cannot be computed" in one.message
    blocked = [row for row in report.rows if row.planned.status == "failed"]
    assert {row.planned.status for row in report.rows} == {"failed", "unsupported"}
    photographs = [one.cells for one in report.missing if "photographs" in one.message]
    assert sum(photographs) == len(blocked)
    for method in ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup", "two_dgs"):
        assert told(report, f"{tmp_path / 'output' / method}: there is no such file or folder; models of ")
        assert told(report, f"renderings of {method} on ")
    scan = told(report, "data of the Chamfer distance on 15 scenes: 60 cells will lack a part")
    assert not scan.blocks


def test_one_missing_thing_hides_no_other(tmp_path: Path) -> None:
    shutil.copytree(STUBS / "scenes" / "mipnerf360" / "pebble", tmp_path / "360" / "pebble")
    shutil.copytree(tmp_path / "360" / "pebble", tmp_path / "360" / "bonsai")
    shutil.rmtree(tmp_path / "360" / "pebble" / "images_4")
    shutil.rmtree(tmp_path / "360" / "pebble" / "images")
    shutil.copytree(PEBBLE / "two_dts", tmp_path / "models" / "bonsai")
    text = """
datasets = [{ name = "mipnerf360", path = "360" }]
[[methods]]
name = "two_dts"
model = "models/{scene}"
training = "t/{scene}.json"
non_engine = "reference"
"""
    report = run_protocol(parse_protocol(text.encode(), tmp_path / "p.toml"), dry=True)
    assert report.exit_status == 3
    folder = told(report, "photographs and cameras")
    assert (folder.code, folder.cells, folder.blocks) == ("SCENE_IMAGE_FOLDER", 4, True)
    model = told(
        report, f"{tmp_path / 'models' / 'pebble'}: there is no such file or folder; models of two_dts on "
    )
    assert (model.code, model.cells) == ("FILE_NOT_FOUND", 4)
    training = told(report, "training records of two_dts on 2 scenes: 8 cells will lack a part")
    assert training.message.startswith(f"{tmp_path / 't'}: ")
    assert {row.planned.cell.scene: row.planned.status for row in report.rows} == {
        "bonsai": "pending",
        "pebble": "failed",
    }


def test_a_dataset_that_is_not_there_hides_no_other(tmp_path: Path) -> None:
    whole = protocol(tmp_path, ("two_dts",))
    more = whole.text + b'[[datasets]]\nname = "mine"\npath = "nowhere"\n'
    report = run_protocol(parse_protocol(more, whole.path), dry=True)
    assert report.exit_status == 3
    assert {row.planned.status for row in report.rows} == {"pending"}
    (lost,) = report.missing
    assert lost.message.startswith(f"{tmp_path / 'nowhere'}: there is no such folder; the scenes of mine")
    assert lost.cells == 0


def test_a_model_whose_method_cannot_be_told_is_missing(tmp_path: Path) -> None:
    text = protocol(tmp_path, ("two_dts",)).text.replace(b'name = "two_dts"', b'name = "auto"')
    broken = text.replace(str(PEBBLE).encode(), b"nowhere").replace(b"{method}", b"x")
    report = run_protocol(parse_protocol(broken, tmp_path / "p.toml"), dry=True)
    assert (report.exit_status, report.rows) == (3, ())
    assert report.missing[0].code == "FILE_NOT_FOUND"


def test_where_all_is_there_nothing_is_missing(tmp_path: Path) -> None:
    report = run_protocol(protocol(tmp_path), dry=True)
    assert report.missing == ()
    assert report.exit_status == 0
