"""A dry run lists every missing input once, with its cells, and has the exit status of a real run."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from msb.adapters.exporter import export
from msb.asset import write_asset
from msb.bench.missing_inputs import Missing
from msb.bench.models import detect_method
from msb.bench.protocol import ProtocolFile, parse_protocol, read_example
from msb.bench.run import Report, run_protocol
from msb.errors import UsageError
from msb.report.collect import collect
from msb.report.numbers import Key
from msb.report.results import read_results
from msb.scenes import read_scene
from tests.bench.protocols import PEBBLE, STUBS, change_tables, make_protocol


def find(report: Report, word: str) -> Missing:
    """Return the only missing input whose message contains the word."""
    (missing,) = [missing for missing in report.missing if word in missing.message]
    return missing


@pytest.mark.slow
def test_the_paper_in_an_empty_folder_lists_each_dataset_and_method_once(tmp_path: Path) -> None:
    report = run_protocol(parse_protocol(read_example("paper"), tmp_path / "paper.toml"), dry=True)
    assert report.exit_status == 3
    assert list(tmp_path.iterdir()) == []
    # Extras and engines depend on this machine and are not counted.
    files = [m for m in report.missing if m.code not in ("EXTRA_MISSING", "ENGINE_MISSING")]
    assert len(files) == 27
    for name, scenes in (("360_v2", 9), ("tandt", 2), ("nerf_synthetic", 8), ("dtu", 15)):
        missing = find(report, f"{tmp_path / 'data' / name}: ")
        assert f"{scenes} scenes: {missing.cells} cells" in missing.message
    blocked = [row for row in report.rows if row.planned.status == "failed"]
    assert {row.planned.status for row in report.rows} == {"failed", "unsupported"}
    photographs = [missing.cells for missing in report.missing if "photographs" in missing.message]
    assert sum(photographs) == len(blocked)
    for method in ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup", "two_dgs"):
        model = f"{tmp_path / 'output' / method}: "
        assert any(missing.blocks for missing in report.missing if missing.message.startswith(model))
        assert find(report, f"renderings of {method} on ").blocks
        timing = find(report, f"{tmp_path / 'timing' / method}: ")
        assert not timing.blocks
        if method != "two_dgs":
            assert not find(report, f"{tmp_path / 'training' / method}: ").blocks
    scan = find(report, "data for the Chamfer")
    assert (scan.cells, scan.blocks) == (60, False)


@pytest.mark.slow
def test_a_run_of_the_paper_goes_on_without_trainings_and_timings(tmp_path: Path) -> None:
    garden, model = tmp_path / "data" / "360_v2" / "garden", tmp_path / "output/two_dts/mipnerf360/garden"
    shutil.copytree(STUBS / "scenes" / "mipnerf360" / "pebble", garden)
    shutil.copytree(PEBBLE / "two_dts", model)
    file = parse_protocol(read_example("paper"), tmp_path / "paper.toml")
    tables: dict[str, Any] = {"timing": {"frames": 1, "seconds": 0.0}}
    file = change_tables(file, metrics={"vgg_weights": None}, videos=None, engines=(), variants=(), **tables)
    report = run_protocol(file, only=["two_dts/garden/dedicated", "two_dts/garden/standard"])
    assert {row.planned.cell.condition_key for row in report.rows} == {"dedicated", "standard"}
    for row in report.rows:
        assert row.result is not None
        assert (row.result.status, row.result.reasons["training"].code) == ("done", "FILE_NOT_FOUND")
    numbers = collect(read_results(file.results))
    key = Key("mipnerf360", "garden", "two_dts", "non_engine", "train_seconds")
    assert str(tmp_path / "training") in str(numbers.number(key).reason)


def test_all_missing_inputs_are_listed(tmp_path: Path) -> None:
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
    folder = find(report, "photographs")
    assert (folder.code, folder.cells, folder.blocks) == ("SCENE_IMAGE_MISSING", 4, True)
    model = find(report, f"{tmp_path / 'models' / 'pebble'}: ")
    assert (model.code, model.cells) == ("FILE_NOT_FOUND", 4)
    training = find(report, f"{tmp_path / 't'}: ")
    assert (training.cells, training.blocks) == (8, False)
    assert {row.planned.cell.scene: row.planned.status for row in report.rows} == {
        "bonsai": "pending",
        "pebble": "failed",
    }


def test_a_folder_with_a_manifest_is_an_asset_under_any_name(tmp_path: Path) -> None:
    write_asset(export(PEBBLE / "two_dts"), tmp_path / "model", "folder")
    assert detect_method(tmp_path / "model") == "two_dts"
    model = json.dumps(str(tmp_path / "model"))
    text = make_protocol(tmp_path, ("two_dts",)).text.decode()
    text = text.replace(json.dumps(str(PEBBLE / "{method}")), model).replace('"two_dts"', '"auto"')
    report = run_protocol(parse_protocol(text.encode(), tmp_path / "p.toml"), dry=True)
    assert (report.exit_status, report.missing) == (0, ())


def official(tmp_path: Path) -> tuple[ProtocolFile, list[Path]]:
    """Return a protocol with official renderings only, and the files of the renderings."""
    folder = tmp_path / "renders"
    folder.mkdir()
    views = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble").test
    for number, view in enumerate(views):
        Image.new("RGB", (view.width, view.height)).save(folder / f"{number:05d}.png")
    keys = 'non_engine = "renders"\nconditions = ["non_engine", "exported_mesh"]'
    return make_protocol(tmp_path, ("two_dts",), keys=keys), sorted(folder.iterdir())


def test_official_renderings_are_checked(tmp_path: Path) -> None:
    file, pictures = official(tmp_path)
    assert run_protocol(file, dry=True).missing == ()
    Image.new("RGB", (9, 7)).save(pictures[0])
    (wrong,) = run_protocol(file, dry=True).missing
    assert (wrong.code, wrong.cells, wrong.blocks) == ("METRIC_SIZES_DIFFER", 1, True)
    assert wrong.message.startswith(f"{pictures[0]}: ")
    pictures[1].unlink()
    report = run_protocol(file, dry=True)
    (absent,) = report.missing
    assert absent.code == "METRIC_IMAGE_NAMES"
    states = {row.planned.cell.condition: row.planned.status for row in report.rows}
    assert states == {"non_engine": "failed", "exported_mesh": "pending"}
    assert report.exit_status == 3


def test_missing_extras_are_listed_with_everything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("torch", "lpips", "av", "skimage"):
        monkeypatch.setitem(sys.modules, module, None)
    tail = '[metrics]\nvgg_weights = "vgg.pth"\n[videos]\n'
    file = make_protocol(tmp_path, ("two_dts",), keys='training = "t.json"', tail=tail)
    report = run_protocol(file, dry=True)
    assert report.exit_status == 3
    assert {row.planned.status for row in report.rows} == {"failed"}
    for extra in ("bench", "video", "lpips"):
        missing = find(report, f"meshsplatbench[{extra}]")
        assert (missing.code, missing.cells, missing.blocks) == ("EXTRA_MISSING", 3, True)
    assert not find(report, f"{tmp_path / 't.json'}: ").blocks
    assert find(report, f"{tmp_path / 'vgg.pth'}: ").code == "FILE_NOT_FOUND"
    assert len(report.missing) == 5
    with pytest.raises(UsageError, match="EXTRA_MISSING"):
        run_protocol(file)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_device_blocks_every_cell(tmp_path: Path) -> None:
    report = run_protocol(make_protocol(tmp_path, ("two_dts",), head='device = "nowhere:7"'), dry=True)
    (device,) = report.missing
    assert (device.code, device.cells, device.blocks) == ("DEVICE_NOT_FOUND", 3, True)
    assert report.exit_status == 3


def test_a_missing_engine_blocks_its_own_cells_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("msb.engines.webgpu")
    monkeypatch.setattr("msb.engines.webgpu.WgpuRenderer.missing", lambda: "wgpu-py is not installed")
    report = run_protocol(make_protocol(tmp_path, head='engines = ["wgpu"]'), dry=True)
    (engine,) = report.missing
    assert (engine.code, engine.cells) == ("ENGINE_MISSING", 1)
    blocked = {row.planned.cell.condition_key for row in report.rows if row.planned.status == "failed"}
    assert blocked == {"standard/wgpu"}


@pytest.mark.parametrize("address", ["", "tcp://x", "tcp://x:", "tcp://x:99999", "tcp://:1"])
def test_invalid_scheduler_addresses_are_rejected_at_once(tmp_path: Path, address: str) -> None:
    for dry in (True, False):
        with pytest.raises(UsageError, match="USAGE"):
            run_protocol(make_protocol(tmp_path, ("two_dts",)), dry=dry, scheduler=address)
    report = run_protocol(make_protocol(tmp_path, ("two_dts",)), dry=True, scheduler="nonsense://x:1")
    assert report.missing[0].code in ("RUN_SCHEDULER", "EXTRA_MISSING")
