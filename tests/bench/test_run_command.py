"""`msb run` as its users meet it."""

import json
from pathlib import Path

import pytest

from msb.bench.commands.run import RunOutput
from msb.bench.protocol import example, parse_protocol
from msb.errors import UsageError
from tests.bench.protocols import PEBBLE, STUBS
from tests.cli.conftest import Here, Msb
from tests.conftest import ROOT

SCENE, MODEL = STUBS / "scenes" / "nerf_synthetic" / "pebble", PEBBLE / "two_dts"


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


@pytest.mark.parametrize("name", ["paper", "demo"])
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
