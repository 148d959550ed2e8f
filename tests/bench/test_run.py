"""Runs on a shipped scene and `msb run`: records, repeated runs, changed inputs and failures."""

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
from msb.bench.folder import Results, lock_results
from msb.bench.gaps import scene_gaps
from msb.bench.inputs import VOUCHED
from msb.bench.protocol import ProtocolFile, parse_protocol, read_example
from msb.bench.protocol_tables import MethodTable
from msb.bench.records import CONDITIONS, read_result
from msb.bench.run import run_protocol
from msb.bench.track import track as tracked
from msb.errors import MsbError, UsageError
from msb.metrics.ground_truth import ground_truth
from msb.scenes.datasets import read_scene
from msb.views import choose_views
from tests.bench.protocols import (
    PEBBLE,
    STUBS,
    Notes,
    change_tables,
    get_plan,
    make_protocol,
    read_cell,
    read_images,
    read_records,
)
from tests.cli.conftest import Here, Msb
from tests.conftest import ROOT, of_the_whole

SCENE = STUBS / "scenes" / "nerf_synthetic" / "pebble"


def test_every_cell_has_a_complete_record(finished: ProtocolFile) -> None:
    names = {tuple(name.split("/")[3:5]) for name in read_records(finished.results)}
    assert names == set(product(("two_dts", "diffsoup"), CONDITIONS))
    record = read_cell(finished, "two_dts/dedicated")
    assert (record.status, record.reason, record.reasons) == ("done", None, {})
    assert record.setup.background == (1.0, 1.0, 1.0)
    assert record.setup.camera_convention == "gs_fov"
    assert (record.renderer.name, record.renderer.kind) == ("msb-dedicated", "msb")
    assert record.renderer.settings["rasterizer"] == "2D"
    assert record.asset.sha256 == hashlib.sha256(Path(record.asset.path).read_bytes()).hexdigest()
    assert record.checkpoint.path == str(PEBBLE / "two_dts")
    assert record.checkpoint.bytes >= (PEBBLE / "two_dts" / "ckpt" / "30000.ckpt").stat().st_size
    assert record.timing.frames == 2
    assert record.timing.seconds == pytest.approx(2 / record.timing.fps)
    assert 1000 / record.timing.fps >= record.timing.mean_ms * 0.99
    assert record.memory.total == sum(record.memory.uses.values()) > 0
    assert record.device["device"]["kind"] == record.timing.device_kind
    assert (finished.results / "protocol.toml").read_bytes() == finished.text
    mesh = read_cell(finished, "two_dts/exported_mesh")
    assert (mesh.audit.topology, mesh.quality) == ("triangle_soup", None)


def test_metrics_are_those_of_the_stored_images(finished: ProtocolFile) -> None:
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
    assert [metric["name"] for metric in quality.metrics] == ["psnr", "ssim"]


def test_assets_of_a_run_are_viewed_from_the_cameras_of_the_scene(finished: ProtocolFile) -> None:
    views = choose_views(msb.load(read_cell(finished, "two_dts/standard").asset.path))
    scene = read_scene(SCENE, dataset="nerf_synthetic")
    assert views.origin == "training"
    assert {view.name for view in views.cameras} <= {camera.name for camera in [*scene.train, *scene.test]}


def test_conditions_are_comparable_or_give_a_reason(finished: ProtocolFile) -> None:
    conditions = {
        name: read_cell(finished, f"two_dts/{name}") for name in ("non_engine", "dedicated", "standard")
    }
    gaps = scene_gaps("psnr", conditions)
    assert gaps.adapt.value == pytest.approx(0, abs=0.05)  # Dedicated must equal our reference renderer
    assert gaps.deploy.value > 0.2
    assert conditions["non_engine"].renderer.kind == "msb_reference"
    unsupported = read_cell(finished, "diffsoup/standard")
    assert (unsupported.status, unsupported.reason.code) == ("unsupported", "UNSUPPORTED_TIER")
    assert read_cell(finished, "diffsoup/dedicated").setup.camera_convention == "full_K"


@pytest.mark.slow
def test_redo_and_only_select_the_work(again: ProtocolFile) -> None:
    before = {path: path.stat().st_mtime_ns for path in again.results.rglob("*.*g")}
    assert set(get_plan(run_protocol(again)).values()) == {"done", "unsupported"}
    assert {path: path.stat().st_mtime_ns for path in before} == before
    report = run_protocol(again, only=["two_dts/standard", "exported_mesh/diffsoup"], redo=True)
    assert get_plan(report) == {
        "two_dts/standard": {"quality": "requested", "timing": "requested"},
        "diffsoup/exported_mesh": {"audit": "requested"},
    }
    for name in ("nothing", "two_dts/diffsoup"):
        with pytest.raises(MsbError, match="USAGE"):
            run_protocol(again, only=[name])


def test_a_dry_run_writes_nothing(finished: ProtocolFile, tmp_path: Path) -> None:
    fresh = replace(finished, path=tmp_path / "protocol.toml")
    plan = get_plan(run_protocol(fresh, dry=True))
    assert list(tmp_path.iterdir()) == []
    assert plan["two_dts/dedicated"] == {"quality": "new"}
    assert plan["two_dts/exported_mesh"] == {"audit": "new"}
    assert plan["diffsoup/standard"] == "unsupported"
    assert set(get_plan(run_protocol(finished, dry=True)).values()) == {"done", "unsupported"}


@pytest.mark.slow
def test_only_changed_parts_are_repeated(again: ProtocolFile) -> None:
    other = change_tables(again, method={"settings": {"gamma": 2.0}}, timing={"frames": 3})
    plan = get_plan(run_protocol(other, only=["nerf_synthetic"]))
    assert plan["two_dts/dedicated"] == {"quality": "settings changed", "timing": "settings, clock changed"}
    assert plan["two_dts/non_engine"] == {"quality": "settings changed"}
    assert plan["two_dts/exported_mesh"] == "done"
    assert plan["diffsoup/dedicated"] == {"timing": "clock changed"}
    assert read_cell(again, "two_dts/dedicated").renderer.settings["gamma"] == 2.0
    timed = read_cell(again, "diffsoup/dedicated")
    assert timed.timing.frames == 3
    assert timed.quality is not None, "the finished part is kept"


@pytest.mark.slow
def test_changed_photographs_and_models_are_detected(again: ProtocolFile, tmp_path: Path) -> None:
    shutil.copytree(SCENE.parent, tmp_path / "scenes")
    shutil.copytree(PEBBLE / "two_dts", tmp_path / "model")
    places = {"dataset": {"path": str(tmp_path / "scenes")}, "method": {"model": str(tmp_path / "model")}}
    here = change_tables(again, **places, alone=True)
    assert set(get_plan(run_protocol(here)).values()) == {"done"}, "a copy has the same content"
    first, second = (Path(str(camera.image_path)) for camera in read_scene(SCENE).test[:2])
    shutil.copy(second, tmp_path / "scenes" / "pebble" / first.relative_to(SCENE))
    plan = get_plan(run_protocol(here, dry=True))
    assert plan["two_dts/standard"] == {"quality": "photographs changed"}
    config = tmp_path / "model" / "config.yaml"
    config.write_text(config.read_text().replace("max_sh_degree: 1", "max_sh_degree: 0"))
    plan = get_plan(run_protocol(here))
    assert "asset" in str(plan["two_dts/exported_mesh"])


@pytest.mark.slow
def test_a_failure_affects_its_own_cells_only(again: ProtocolFile, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    (broken / "ckpt").mkdir(parents=True)
    (broken / "ckpt" / "30000.ckpt").write_bytes(b"not a checkpoint")
    method, lost = (
        MethodTable(name=name, model=str(model))
        for name, model in (("triangle_splatting", broken), ("auto", tmp_path / "nowhere"))
    )
    methods = (method, lost, *again.protocol.methods)
    report = run_protocol(change_tables(again, methods=methods, dataset={"scenes": ("pebble", "gone")}))
    assert report.exit_status == 3
    rows = {row.planned.cell.names[1:]: row for row in report.rows}
    assert rows["pebble", "two_dts", "dedicated"].planned.status == "done"
    failed = rows["pebble", "triangle_splatting", "dedicated"]
    assert (failed.result.status, failed.reasons["cell"].code) == ("failed", "CHECKPOINT_NOT_RECOGNISED")
    assert rows["gone", "two_dts", "dedicated"].reasons["cell"].code == "FILE_NOT_FOUND"
    assert rows["gone", "diffsoup", "standard"].reasons == {}, "an unsupported condition is not a failure"
    assert [reason.code for reason in report.models.values()] == ["FILE_NOT_FOUND"]


@pytest.mark.slow
def test_two_models_of_one_method_need_labels(again: ProtocolFile) -> None:
    twice = change_tables(again, methods=(again.protocol.methods[0],) * 2)
    with pytest.raises(MsbError, match="PROTOCOL_INVALID"):
        run_protocol(twice)


@pytest.mark.slow
def test_training_records_are_read_and_may_be_missing(again: ProtocolFile, tmp_path: Path) -> None:
    record = tmp_path / "two_dts.json"
    cost = {"seconds": 600.0, "peak_gpu_memory_bytes": 5 << 30}
    track = json.loads(tracked([sys.executable, "-c", ""]).to_json()) | cost
    record.write_text(json.dumps(track))
    training = {"training": str(tmp_path / "{method}.json")}
    methods = tuple(method.model_copy(update=training) for method in again.protocol.methods)
    here = change_tables(again, methods=methods)
    assert get_plan(run_protocol(here, only=["dedicated"])) == {
        "two_dts/dedicated": {"training": "new"},
        "diffsoup/dedicated": {"training": "new"},
    }
    result = read_cell(again, "two_dts/dedicated")
    assert (result.training.seconds, result.training.peak_memory_bytes) == (600, 5 << 30)
    assert result.quality is not None
    missing = read_cell(again, "diffsoup/dedicated")
    assert (missing.status, missing.reasons["training"].code) == ("done", "FILE_NOT_FOUND")
    record.write_text(json.dumps({**track, "exit_status": 1}))
    assert run_protocol(here, only=["dedicated/two_dts"]).exit_status == 3
    assert read_cell(again, "two_dts/dedicated").reasons["training"].code == "TRAINING_FAILED"


@pytest.mark.slow
def test_one_run_at_a_time_and_temporary_files_are_removed(again: ProtocolFile) -> None:
    (again.results / "cells" / ".result.json.0123456789ab.part").write_text("half")
    (again.results / ".images.0123456789ab.part").mkdir()
    (again.results / ".keep.part").write_text("a file of the user")
    with lock_results(again.results), pytest.raises(MsbError, match="RESULTS_BUSY"):
        run_protocol(again)
    run_protocol(again)
    assert sorted(path.name for path in again.results.rglob("*.part")) == [".keep.part"]
    assert not (again.results / ".run.json").exists()


@pytest.mark.slow
def test_dtu_has_a_chamfer_distance(tmp_path: Path) -> None:
    head = f"[chamfer]\ndata = {json.dumps(str(STUBS / 'scenes' / 'dtu'))}"
    file = make_protocol(tmp_path, ("mesh_splatting",), dataset="dtu", head=head)
    report = run_protocol(file, only=["exported_mesh"])
    assert report.exit_status == 0
    path = Results(file.results).record(report.rows[0].planned.cell)
    result: Any = read_result(path)
    assert 0 < result.chamfer.overall < 5
    assert result.chamfer.metric["name"] == "chamfer_dtu"
    assert result.audit is not None
    assert run_protocol(change_tables(file, chamfer={"data": str(tmp_path)})).exit_status == 3
    result = read_result(path)
    assert (result.status, result.chamfer, result.reasons["chamfer"].code) == ("done", None, "FILE_NOT_FOUND")


@pytest.mark.slow
def test_differences_of_a_training_are_recorded_with_one_warning(tmp_path: Path) -> None:
    model = tmp_path / "models" / "triangle_splatting"
    shutil.copytree(PEBBLE / "triangle_splatting", model)
    (model / "cfg_args").write_text("Namespace(white_background=False, eval=False)")
    file = change_tables(make_protocol(tmp_path, ("triangle_splatting",)), method={"model": str(model)})
    watch = Notes()
    assert run_protocol(file, only=["dedicated", "exported_mesh"], watch=watch).exit_status == 0
    for text in ("eval=False", "over black"):
        assert sum(text in line for line in watch.lines) == 1
        for name in ("dedicated", "exported_mesh"):
            sentences = read_cell(file, f"triangle_splatting/{name}").trained
            assert sum(text in sentence for sentence in sentences) == 1


@pytest.mark.slow
def test_an_unknown_split_is_noted_until_the_protocol_vouches_for_it(again: ProtocolFile) -> None:
    # The record of the finished run has the note, and no part is computed again.
    assert "held out" in read_cell(again, "two_dts/dedicated").trained[0]
    report = run_protocol(change_tables(again, method={"held_out": True}), only=["two_dts/dedicated"])
    assert [row.planned.status for row in report.rows] == ["done"]
    assert read_cell(again, "two_dts/dedicated").trained == (VOUCHED,)


@pytest.mark.slow
def test_methods_without_our_renderer_are_evaluated(tmp_path: Path) -> None:
    methods = ("triangle_splatting_plus", *PLACES)
    file = make_protocol(tmp_path, methods)
    assert run_protocol(file, jobs=2).exit_status == 0
    for method in methods:
        standard = read_cell(file, f"{method}/standard")
        assert standard.status == "done"
        assert standard.quality.psnr > 22
        dedicated = read_cell(file, f"{method}/dedicated")
        assert dedicated.status == ("unsupported" if method in PLACES else "done")


MODEL = PEBBLE / "two_dts"


@pytest.fixture(scope="module")
def results(msb: Msb, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of one model on one scene."""
    folder = tmp_path_factory.mktemp("cli") / "results"
    assert "3 computed" in msb("run", "--scene", SCENE, "-o", folder, MODEL, status=0).out
    return folder


@pytest.mark.slow
def test_one_asset_on_one_scene(msb: Msb, results: Path) -> None:
    data = msb("run", "--scene", SCENE, "-o", results, "--json", "-", MODEL, status=0).json
    assert (data["schema"], data["results"]) == ("msb.run/1", str(results))
    assert {cell["condition"]: (cell["plan"], cell["status"]) for cell in data["cells"]} == dict.fromkeys(
        ("dedicated", "standard", "exported_mesh"), ("done", "done")
    )
    assert data["cells"][0]["psnr"] > 15
    # The results contain the generated protocol, which is valid.
    text = msb("run", "--dry-run", "-o", results, results / "protocol.toml", COLUMNS="80", status=0).out
    assert "3 unchanged" in text
    assert max(map(len, text.splitlines()[:-1])) <= 80


def test_an_invalid_model_is_rejected_before_anything_is_written(here: Here, tmp_path: Path) -> None:
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
def test_render_draws_the_same_images_as_a_run(msb: Msb, results: Path, tmp_path: Path) -> None:
    args = ("--scene", SCENE, "--tier", "both", "--name", "{tier}/{camera}", "--json", "-")
    drawn = msb("render", *args, "-o", tmp_path, MODEL, status=0)
    for tier in ("dedicated", "standard"):
        scored = results / "cells" / "nerf_synthetic" / "pebble" / "two_dts" / tier / "images"
        assert read_images(tmp_path / tier) == read_images(scored) != {}
    about = {key: drawn.json[0]["scene"][key] for key in ("dataset", "split", "camera_convention")}
    assert about == {"dataset": "nerf_synthetic", "split": "test", "camera_convention": "gs_fov"}


@pytest.mark.slow
def test_each_failure_is_one_line(msb: Msb, tmp_path: Path) -> None:
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
    assert codes.count("CHECKPOINT_NOT_RECOGNISED") == 1, "three cells have the same error"
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
def test_wrong_usage_is_one_line(msb: Msb, tmp_path: Path, args: list[str], code: str) -> None:
    msb("run", "-o", tmp_path / "r", *args, cwd=tmp_path).ends(2 if code == "USAGE" else 3, f"{code}: ")


@pytest.mark.parametrize("name", ["paper", pytest.param("demo", marks=of_the_whole)])
def test_an_example_is_a_valid_protocol(msb: Msb, name: str) -> None:
    result = msb("run", "--example", name, "-q")
    assert (result.status, result.err, result.out.encode()) == (0, "", read_example(name))
    assert parse_protocol(result.out.encode(), "p.toml").protocol.methods
    msb("run --example", name, "--json", "-").ends(2, "USAGE: ")


def test_json_replaces_only_the_json_of_a_run(here: Here, tmp_path: Path) -> None:
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
    file.write_text("precious")  # while the run is in progress
    with pytest.raises(UsageError, match="OUTPUT_EXISTS"):
        output.write_json({"schema": "msb.run/1"})
    assert file.read_text() == "precious"
