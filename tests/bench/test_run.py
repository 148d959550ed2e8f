"""A run on a shipped scene and `msb run`: what is recorded, left alone, and done about failures."""

import hashlib
import json
import shutil
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from data_stubs.made_meshes import PLACES
from msb import metrics
from msb.bench.commands.run import RunOutput
from msb.bench.folder import Results, exclusive
from msb.bench.gaps import scene_gaps
from msb.bench.protocol import ProtocolFile, example, parse_protocol
from msb.bench.protocol_tables import MethodTable
from msb.bench.records import CONDITIONS, read_result
from msb.bench.run import run_protocol
from msb.bench.track import track as tracked
from msb.errors import MsbError, UsageError
from msb.metrics.ground_truth import ground_truth
from msb.scenes.datasets import read_scene
from msb.views import choose_views
from tests.bench.protocols import PEBBLE, STUBS, Notes, cell, changed, planned, protocol, records
from tests.cli.conftest import Here, Msb
from tests.conftest import ROOT, of_the_whole

SCENE = STUBS / "scenes" / "nerf_synthetic" / "pebble"


def test_every_cell_has_a_whole_record(finished: ProtocolFile) -> None:
    found = {tuple(name.split("/")[3:5]) for name in records(finished.results)}
    assert found == set(product(("two_dts", "diffsoup"), CONDITIONS))
    one = cell(finished, "two_dts/dedicated")
    assert (one.status, one.reason, one.reasons) == ("done", None, {})
    assert one.setup.background == (1.0, 1.0, 1.0)
    assert one.setup.camera_convention == "gs_fov"
    assert (one.renderer.name, one.renderer.kind) == ("msb-dedicated", "msb")
    assert one.renderer.settings["rasterizer"] == "2D"
    assert one.asset.sha256 == hashlib.sha256(Path(one.asset.path).read_bytes()).hexdigest()
    assert one.checkpoint.path == str(PEBBLE / "two_dts")
    assert one.checkpoint.bytes >= (PEBBLE / "two_dts" / "ckpt" / "30000.ckpt").stat().st_size
    assert one.timing.frames == 2
    assert one.timing.seconds == pytest.approx(2 / one.timing.fps)
    assert 1000 / one.timing.fps >= one.timing.mean_ms * 0.99
    assert one.memory.total == sum(one.memory.uses.values()) > 0
    assert one.device["device"]["kind"] == one.timing.device_kind
    assert (finished.results / "protocol.toml").read_bytes() == finished.text
    mesh = cell(finished, "two_dts/exported_mesh")
    assert (mesh.audit.topology, mesh.quality) == ("triangle_soup", None)


def test_numbers_are_those_of_the_images_beside_the_record(finished: ProtocolFile) -> None:
    folder = finished.results / "cells" / "nerf_synthetic" / "pebble" / "two_dts" / "standard"
    quality = read_result(folder / "result.json").quality
    scene = read_scene(SCENE, dataset="nerf_synthetic")
    assert [image.name for image in quality.images] == [camera.name for camera in scene.test]
    for image, camera in zip(quality.images, scene.test, strict=True):
        pred, truth = (metrics.read_image(folder / name) for name in (image.file, image.gt))
        assert np.array_equal(truth, np.round(ground_truth(scene, camera) * 255))
        assert image.psnr == metrics.psnr(pred, truth)
        assert image.ssim == metrics.ssim(pred, truth)
        assert image.lpips is None
    assert quality.psnr == pytest.approx(np.mean([image.psnr for image in quality.images]), rel=1e-12)
    assert quality.lpips_reason
    assert [one["name"] for one in quality.metrics] == ["psnr", "ssim"]


def test_the_assets_of_a_run_are_judged_by_the_cameras_of_its_scene(finished: ProtocolFile) -> None:
    one = cell(finished, "two_dts/standard")
    views = choose_views(msb.load(one.asset.path))
    scene = read_scene(SCENE, dataset="nerf_synthetic")
    assert views.origin == "training"
    assert {view.name for view in views.cameras} <= {camera.name for camera in [*scene.train, *scene.test]}


def test_conditions_can_be_compared_and_the_unsupported_says_why(finished: ProtocolFile) -> None:
    conditions = {name: cell(finished, f"two_dts/{name}") for name in ("non_engine", "dedicated", "standard")}
    gaps = scene_gaps("psnr", conditions)
    assert gaps.adapt.value == pytest.approx(0, abs=0.05)  # our reference is what Dedicated is held to
    assert gaps.deploy.value > 0.2
    assert conditions["non_engine"].renderer.kind == "msb_reference"
    other = cell(finished, "diffsoup/standard")
    assert other.status == "unsupported"
    assert other.reason.code == "UNSUPPORTED_TIER"
    assert cell(finished, "diffsoup/dedicated").setup.camera_convention == "full_K"


@pytest.mark.slow
def test_redo_and_only(again: ProtocolFile) -> None:
    before = {path: path.stat().st_mtime_ns for path in again.results.rglob("*.*g")}
    assert set(planned(run_protocol(again)).values()) == {"done", "unsupported"}
    assert {path: path.stat().st_mtime_ns for path in before} == before
    found = run_protocol(again, only=["two_dts/standard", "exported_mesh/diffsoup"], redo=True)
    assert planned(found) == {
        "two_dts/standard": {"quality": "asked for", "timing": "asked for"},
        "diffsoup/exported_mesh": {"audit": "asked for"},
    }
    for name in ("nothing", "two_dts/diffsoup"):
        with pytest.raises(MsbError, match="USAGE"):
            run_protocol(again, only=[name])


def test_a_dry_run_tells_and_writes_nothing(finished: ProtocolFile, tmp_path: Path) -> None:
    fresh = replace(finished, path=tmp_path / "protocol.toml")
    found = planned(run_protocol(fresh, dry=True))
    assert list(tmp_path.iterdir()) == []
    assert found["two_dts/dedicated"] == {"quality": "new"}
    assert found["two_dts/exported_mesh"] == {"audit": "new"}
    assert found["diffsoup/standard"] == "unsupported"
    assert set(planned(run_protocol(finished, dry=True)).values()) == {"done", "unsupported"}


@pytest.mark.slow
def test_only_what_changed_is_done_again_and_it_says_what(again: ProtocolFile) -> None:
    other = changed(again, method={"settings": {"gamma": 2.0}}, timing={"frames": 3})
    told = planned(run_protocol(other, only=["nerf_synthetic"]))
    assert told["two_dts/dedicated"] == {"quality": "settings changed", "timing": "settings, clock changed"}
    assert told["two_dts/non_engine"] == {"quality": "settings changed"}
    assert told["two_dts/exported_mesh"] == "done"
    assert told["diffsoup/dedicated"] == {"timing": "clock changed"}
    assert cell(again, "two_dts/dedicated").renderer.settings["gamma"] == 2.0
    timed = cell(again, "diffsoup/dedicated")
    assert timed.timing.frames == 3
    assert timed.quality is not None, "the part that was done stays"


@pytest.mark.slow
def test_a_changed_photograph_or_model_is_noticed(again: ProtocolFile, tmp_path: Path) -> None:
    shutil.copytree(SCENE.parent, tmp_path / "scenes")
    shutil.copytree(PEBBLE / "two_dts", tmp_path / "model")
    places = {"dataset": {"path": str(tmp_path / "scenes")}, "method": {"model": str(tmp_path / "model")}}
    here = changed(again, **places, alone=True)
    assert set(planned(run_protocol(here)).values()) == {"done"}, "another place is no other content"
    first, second = (Path(str(camera.image_path)) for camera in read_scene(SCENE).test[:2])
    shutil.copy(second, tmp_path / "scenes" / "pebble" / first.relative_to(SCENE))
    told = planned(run_protocol(here, dry=True))
    assert told["two_dts/standard"] == {"quality": "photographs changed"}
    config = tmp_path / "model" / "config.yaml"
    config.write_text(config.read_text().replace("max_sh_degree: 1", "max_sh_degree: 0"))
    told = planned(run_protocol(here))
    assert "asset" in str(told["two_dts/exported_mesh"])


@pytest.mark.slow
def test_a_failure_costs_its_own_cells_only(again: ProtocolFile, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    (broken / "ckpt").mkdir(parents=True)
    (broken / "ckpt" / "30000.ckpt").write_bytes(b"not a checkpoint")
    method, lost = (
        MethodTable(name=name, model=str(model))
        for name, model in (("triangle_splatting", broken), ("auto", tmp_path / "nowhere"))
    )
    methods = (method, lost, *again.protocol.methods)
    found = run_protocol(changed(again, methods=methods, dataset={"scenes": ("pebble", "gone")}))
    assert found.exit_status == 3
    states = {
        (row.planned.cell.scene, row.planned.cell.method, row.planned.cell.condition_name): row
        for row in found.rows
    }
    assert states["pebble", "two_dts", "dedicated"].planned.status == "done"
    failed = states["pebble", "triangle_splatting", "dedicated"]
    assert (failed.result.status, failed.reasons["cell"].code) == ("failed", "CHECKPOINT_NOT_RECOGNISED")
    assert states["gone", "two_dts", "dedicated"].reasons["cell"].code == "FILE_NOT_FOUND"
    assert states["gone", "diffsoup", "standard"].reasons == {}, "not supported is no failure"
    assert [reason.code for reason in found.models.values()] == ["FILE_NOT_FOUND"]


@pytest.mark.slow
def test_two_models_of_one_method_on_one_scene_are_refused(again: ProtocolFile) -> None:
    twice = changed(again, methods=(again.protocol.methods[0],) * 2)
    with pytest.raises(MsbError, match="PROTOCOL_INVALID"):
        run_protocol(twice)


@pytest.mark.slow
def test_training_records_are_read_and_may_fail_alone(again: ProtocolFile, tmp_path: Path) -> None:
    record = tmp_path / "two_dts.json"
    cost = {"seconds": 600.0, "peak_gpu_memory_bytes": 5 << 30}
    track = json.loads(tracked([sys.executable, "-c", ""]).to_json()) | cost
    record.write_text(json.dumps(track))
    training = {"training": str(tmp_path / "{method}.json")}
    here = changed(again, methods=tuple(one.model_copy(update=training) for one in again.protocol.methods))
    found = run_protocol(here, only=["dedicated"])
    assert planned(found) == {
        "two_dts/dedicated": {"training": "new"},
        "diffsoup/dedicated": {"training": "new"},
    }
    one = cell(again, "two_dts/dedicated")
    assert (one.training.seconds, one.training.peak_memory_bytes) == (600, 5 << 30)
    assert one.quality is not None
    other = cell(again, "diffsoup/dedicated")
    assert (other.status, other.reasons["training"].code) == ("done", "FILE_NOT_FOUND")
    record.write_text(json.dumps({**track, "exit_status": 1}))
    assert run_protocol(here, only=["dedicated/two_dts"]).exit_status == 3
    assert cell(again, "two_dts/dedicated").reasons["training"].code == "TRAINING_FAILED"


@pytest.mark.slow
def test_one_run_at_a_time_and_leftovers_are_cleared(again: ProtocolFile) -> None:
    left = again.results / "cells" / ".result.json.0123456789ab.part"
    left.write_text("half")
    (again.results / ".images.0123456789ab.part").mkdir()
    mine = again.results / ".keep.part"
    mine.write_text("not ours")
    with exclusive(again.results), pytest.raises(MsbError, match="RESULTS_BUSY"):
        run_protocol(again)
    run_protocol(again)
    assert not left.exists()
    assert sorted(path.name for path in again.results.rglob("*.part")) == [".keep.part"]
    assert not (again.results / ".run.json").exists()


@pytest.mark.slow
def test_dtu_has_a_chamfer_distance(tmp_path: Path) -> None:
    head = f"[chamfer]\ndata = {json.dumps(str(STUBS / 'scenes' / 'dtu'))}"
    file = protocol(tmp_path, ("mesh_splatting",), dataset="dtu", head=head)
    found = run_protocol(file, only=["exported_mesh"])
    assert found.exit_status == 0
    result: Any = read_result(Results(file.results).record(found.rows[0].planned.cell))
    assert 0 < result.chamfer.overall < 5
    assert result.chamfer.metric["name"] == "chamfer_dtu"
    assert result.audit is not None
    assert run_protocol(changed(file, chamfer={"data": str(tmp_path)})).exit_status == 3
    result = read_result(Results(file.results).record(found.rows[0].planned.cell))
    assert (result.status, result.chamfer, result.reasons["chamfer"].code) == ("done", None, "FILE_NOT_FOUND")


@pytest.mark.slow
def test_what_a_training_did_otherwise_is_warned_of_once_and_recorded(tmp_path: Path) -> None:
    model = tmp_path / "models" / "triangle_splatting"
    shutil.copytree(PEBBLE / "triangle_splatting", model)
    (model / "cfg_args").write_text("Namespace(white_background=False, eval=False)")
    file = changed(protocol(tmp_path, ("triangle_splatting",)), method={"model": str(model)})
    watch = Notes()
    assert run_protocol(file, only=["dedicated", "exported_mesh"], watch=watch).exit_status == 0
    for text in ("eval=False", "over black"):
        assert sum(text in line for line in watch.said) == 1
        for name in ("dedicated", "exported_mesh"):
            found = cell(file, f"triangle_splatting/{name}").trained
            assert sum(text in one for one in found) == 1


@pytest.mark.slow
def test_methods_known_by_their_files_are_rows(tmp_path: Path) -> None:
    methods = ("triangle_splatting_plus", *PLACES)
    file = protocol(tmp_path, methods)
    assert run_protocol(file, jobs=2).exit_status == 0
    for method in methods:
        shown = cell(file, f"{method}/standard")
        assert shown.status == "done"
        assert shown.quality.psnr > 22
        own = cell(file, f"{method}/dedicated")
        assert own.status == ("unsupported" if method in PLACES else "done")


MODEL = PEBBLE / "two_dts"


@pytest.fixture(scope="module")
def results(msb: Msb, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of one model on one scene."""
    folder = tmp_path_factory.mktemp("cli") / "results"
    assert "3 done now" in msb("run", "--scene", SCENE, "-o", folder, MODEL, status=0).out
    return folder


@pytest.mark.slow
def test_one_asset_on_one_scene(msb: Msb, results: Path) -> None:
    data = msb("run", "--scene", SCENE, "-o", results, "--json", "-", MODEL, status=0).json
    assert (data["schema"], data["results"]) == ("msb.run/1", str(results))
    assert {cell["condition"]: (cell["plan"], cell["status"]) for cell in data["cells"]} == dict.fromkeys(
        ("dedicated", "standard", "exported_mesh"), ("done", "done")
    )
    assert data["cells"][0]["psnr"] > 15
    # The protocol that was made up is on record, and is one.
    text = msb("run", "--dry-run", "-o", results, results / "protocol.toml", COLUMNS="80", status=0).out
    assert "3 as before" in text
    assert max(map(len, text.splitlines()[:-1])) <= 80


def test_what_is_no_model_is_refused_before_anything_is_written(here: Here, tmp_path: Path) -> None:
    out, empty = tmp_path / "out", tmp_path / "empty.ply"
    out.mkdir()
    (out / "protocol.toml").write_text("of another run")
    empty.touch()
    for model, code in ((tmp_path / "nothing", "FILE_NOT_FOUND"), (empty, "MESH_FILE_INVALID")):
        for folder in (out, tmp_path / "new"):
            here("run", "--scene", SCENE, "-o", folder, model).ends(3, f"{code}: {model}: ")
    assert (out / "protocol.toml").read_text() == "of another run"
    assert [path.name for path in out.iterdir()] == ["protocol.toml"]
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_render_draws_the_views_of_a_scene_as_a_run_scores_them(
    msb: Msb, results: Path, tmp_path: Path
) -> None:
    args = ("--scene", SCENE, "--tier", "both", "--name", "{tier}/{camera}", "--json", "-")
    drawn = msb("render", *args, "-o", tmp_path, MODEL, status=0)
    for tier in ("dedicated", "standard"):
        scored = results / "cells" / "nerf_synthetic" / "pebble" / "two_dts" / tier / "images"
        pictures = {file.relative_to(scored): file.read_bytes() for file in scored.rglob("*.png")}
        folder = tmp_path / tier
        found = {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.png")}
        assert found == pictures != {}
    about = {key: drawn.json[0]["scene"][key] for key in ("dataset", "split", "camera_convention")}
    assert about == {"dataset": "nerf_synthetic", "split": "test", "camera_convention": "gs_fov"}


@pytest.mark.slow
def test_failures_are_lines_and_the_highest_status(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "model.ckpt").write_bytes(b"nothing")
    text = f"""
[[datasets]]
name = "nerf_synthetic"
path = {json.dumps(str(SCENE.parent))}
[[methods]]
name = "two_dts"
model = "model.ckpt"
[[methods]]
name = "mesh"
model = {json.dumps(str(ROOT / "tests/golden/meshes/synthetic_splat_small.ply"))}
conditions = ["exported_mesh"]
"""
    (tmp_path / "p.toml").write_text(text)
    result = msb("run", tmp_path / "p.toml", status=3)
    codes = [line.partition(":")[0] for line in result.err.splitlines()]
    assert codes.count("CHECKPOINT_NOT_RECOGNISED") == 1, "one error of three cells is one line"
    assert result.out.rstrip().splitlines()[-1] == f"next: msb report {tmp_path / 'results'}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "code"),
    [
        (["nothing.toml"], "FILE_NOT_FOUND"),
        ([str(MODEL)], "USAGE"),
        (["--non-engine", "reference", "p.toml"], "USAGE"),
        (["--only", "nobody", str(STUBS / "protocol.toml")], "USAGE"),
        (["--jobs", "0", "p.toml"], "USAGE"),
        ([], "USAGE"),
        (["--example", "paper"], "USAGE"),
    ],
)
def test_wrong_use_is_one_line(msb: Msb, tmp_path: Path, args: list[str], code: str) -> None:
    msb("run", "-o", tmp_path / "r", *args, cwd=tmp_path).ends(2 if code == "USAGE" else 3, f"{code}: ")


@pytest.mark.parametrize("name", ["paper", pytest.param("demo", marks=of_the_whole)])
def test_an_example_is_a_protocol_on_standard_output(msb: Msb, name: str) -> None:
    result = msb("run", "--example", name, "-q")
    assert (result.status, result.err, result.out.encode()) == (0, "", example(name))
    assert parse_protocol(result.out.encode(), "p.toml").protocol.methods
    msb("run --example", name, "--json", "-").ends(2, "USAGE: ")


def test_json_replaces_that_of_a_run_and_nothing_else(here: Here, tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    for text in ("precious", '{"schema": "msb.run/10"}', ""):
        file.write_text(text)
        here("run", "--json", file, tmp_path / "p.toml").ends(2, f"OUTPUT_EXISTS: {file}: ")
        assert file.read_text() == text
    file.unlink()
    for number in (1, 2):
        output = RunOutput(json_file=file)
        output.check_free(file)
        output.write_json({"schema": "msb.run/1", "seconds": number})
        assert json.loads(file.read_text())["seconds"] == number
    output = RunOutput(json_file=file)
    output.check_free(file)
    file.write_text("precious")  # while it runs
    with pytest.raises(UsageError, match="OUTPUT_EXISTS"):
        output.write_json({"schema": "msb.run/1"})
    assert file.read_text() == "precious"
