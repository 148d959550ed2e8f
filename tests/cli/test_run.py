"""`msb run` and `msb track` as their users meet them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msb.base.atomic import REPLACES
from msb.bench.commands.run import RunOutput
from msb.bench.protocol import example, parse_protocol
from msb.errors import UsageError
from msb.scenes.datasets import DATASETS
from tests.cli.conftest import Here, Msb
from tests.conftest import ROOT

STUBS = ROOT / "tests" / "tiny"
SCENE = STUBS / "scenes" / "nerf_synthetic" / "pebble"
MODEL = STUBS / "models" / "pebble" / "two_dts"


@pytest.fixture(scope="module")
def results(msb: Msb, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of one model on one scene."""
    folder = tmp_path_factory.mktemp("cli") / "results"
    result = msb("run", "--scene", SCENE, "-o", folder, MODEL, status=0)
    assert "\n  two_dts      dedicated" in result.out
    assert "3 cells: 3 done now" in result.out
    return folder


@pytest.mark.slow
def test_one_asset_on_one_scene(msb: Msb, results: Path) -> None:
    again = msb("run", "--scene", SCENE, "-o", results, "--json", "-", MODEL, status=0)
    data = again.json
    assert data["schema"] == "msb.run/1"
    assert data["results"] == str(results)
    assert {cell["condition"]: cell["plan"] for cell in data["cells"]} == dict.fromkeys(
        ("dedicated", "standard", "exported_mesh"), "done"
    )
    assert all(cell["status"] == "done" for cell in data["cells"])
    assert data["cells"][0]["psnr"] > 15
    # The protocol that was made up is on record, and is one.
    text = msb("run", "--dry-run", "-o", results, results / "protocol.toml").out
    assert "3 cells: 3 as before" in text
    assert max(map(len, text.splitlines()[:-1])) <= 80


def test_what_is_no_model_is_refused_before_anything_is_written(here: Here, tmp_path: Path) -> None:
    out, empty, nothing = tmp_path / "out", tmp_path / "empty.ply", tmp_path / "nothing"
    out.mkdir()
    (out / "protocol.toml").write_text("of another run")
    empty.touch()
    for model, said in (
        (nothing, f"FILE_NOT_FOUND: {nothing}: there is no such"),
        (empty, f"MESH_FILE_INVALID: {empty}: the file is empty"),
    ):
        here("run", "--scene", SCENE, "-o", out, model).ends(3, said)
        here("run", "--scene", SCENE, "-o", tmp_path / "new", model).ends(3, said)
    assert (out / "protocol.toml").read_text() == "of another run"
    assert [path.name for path in out.iterdir()] == ["protocol.toml"]
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_a_model_that_no_method_knows_is_named_once(msb: Msb, tmp_path: Path) -> None:
    text = f"""
[[datasets]]
name = "nerf_synthetic"
path = {json.dumps(str(SCENE))}
[[methods]]
model = "nothing"
"""
    (tmp_path / "p.toml").write_text(text)
    result = msb("run", tmp_path / "p.toml", status=3)
    assert f"FILE_NOT_FOUND: {tmp_path / 'nothing'}: there is no such file or folder\n" in result.err


@pytest.mark.slow
def test_a_scene_of_a_long_name_breaks_no_line_of_a_terminal(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "a_scene_of_27_letters_12345").symlink_to(SCENE)
    text = f"""
results = "results"
[[datasets]]
name = "nerf_synthetic"
path = "scenes"
[[methods]]
name = "triangle_splatting"
model = {json.dumps(str(MODEL.parent / "triangle_splatting"))}
"""
    (tmp_path / "p.toml").write_text(text)
    lines = msb("run", "--dry-run", tmp_path / "p.toml", COLUMNS="80").out.splitlines()
    assert [len(line.split()) for line in lines[2:6]] == [1, 8, 8, 8]
    assert max(map(len, lines[:-1])) <= 80


@pytest.mark.slow
def test_render_draws_the_views_of_a_scene_as_a_run_scores_them(
    msb: Msb, results: Path, tmp_path: Path
) -> None:
    # A background that a file sets is no wish to draw what does not count.
    args = ("--scene", SCENE, "--tier", "both", "--name", "{tier}/{camera}", "--json", "-")
    drawn = msb("render", *args, "-o", tmp_path, MODEL, MSB_BACKGROUND="#123456", status=0)
    for tier in ("dedicated", "standard"):
        scored = results / "cells" / "nerf_synthetic" / "pebble" / "two_dts" / tier / "images"
        pictures = {file.relative_to(scored): file.read_bytes() for file in scored.rglob("*.png")}
        folder = tmp_path / tier
        found = {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.png")}
        assert found == pictures != {}
    about = {key: drawn.json[0]["scene"][key] for key in ("dataset", "split", "camera_convention")}
    assert about == {"dataset": "nerf_synthetic", "split": "test", "camera_convention": "gs_fov"}


@pytest.mark.slow
def test_what_is_to_do_is_shown_and_not_done(msb: Msb, tmp_path: Path) -> None:
    result = msb("run", "--dry-run", "-o", tmp_path / "r", STUBS / "protocol.toml", status=0)
    assert "80 cells: 76 to do, 4 N/A" in result.out
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_a_dry_run_says_last_and_once_what_is_missing_and_ends_with_3(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "paper.toml").write_bytes(example("paper"))
    result = msb("run", "--dry-run", "paper.toml", cwd=tmp_path, status=3)
    assert "\n  two_dts             dedicated" in result.out
    assert "770 cells: 682 blocked, 88 N/A" in result.out
    lines = result.err.splitlines()
    assert len([line for line in lines if not line.startswith("EXTRA_MISSING")]) == 17
    place = tmp_path / "output" / "mesh_splatting"
    text = f"{place}: there is no such file or folder; models of mesh_splatting on 34 scenes: 136 cells"
    assert f"FILE_NOT_FOUND: {text} cannot be computed" in lines
    data = msb("run", "--dry-run", "--json", "-", "paper.toml", cwd=tmp_path).json
    assert [f"{one['code']}: {one['message']}" for one in data["missing"]] == lines
    assert {cell["reasons"]["cell"]["code"] for cell in data["cells"] if cell["plan"] == "failed"} == {
        "FILE_NOT_FOUND"
    }


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
    lines = result.err.splitlines()
    assert len(lines) == 2  # one error of three cells, and that pebble is no scene of the dataset
    assert any(
        line.startswith("CHECKPOINT_NOT_RECOGNISED: nerf_synthetic pebble two_dts dedicated and 2 more: ")
        for line in lines
    )
    assert result.out.rstrip().splitlines()[-1] == f"next: msb report {tmp_path / 'results'}"
    assert "1 done now" in result.out
    assert "3 failed" in result.out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["nothing.toml"], "FILE_NOT_FOUND: nothing.toml"),
        ([str(MODEL)], "USAGE: "),
        (["--non-engine", "reference", "p.toml"], "USAGE: "),
        (["--only", "nobody", str(STUBS / "protocol.toml")], "USAGE: --only nobody selects no cell"),
        (["--jobs", "0", "p.toml"], "USAGE: "),
        ([], "USAGE: Missing argument 'PROTOCOL'; --example paper prints one"),
        (["--example", "paper"], "USAGE: --out does not go with --example"),
    ],
)
def test_wrong_use_is_one_line(msb: Msb, tmp_path: Path, args: list[str], said: str) -> None:
    msb("run", "-o", tmp_path / "r", *args, cwd=tmp_path).ends(2 if "USAGE" in said else 3, said)


@pytest.mark.parametrize("name", ["paper", "demo"])
def test_an_example_is_a_protocol_on_standard_output(msb: Msb, name: str) -> None:
    result = msb("run", "--example", name, "-q")
    assert (result.status, result.err) == (0, "")
    assert result.out.encode() == example(name)
    protocol = parse_protocol(result.out.encode(), "p.toml").protocol
    names = list(DATASETS) if name == "paper" else ["mipnerf360", "nerf_synthetic"]
    assert [dataset.name for dataset in protocol.datasets] == names
    assert {method.name for method in protocol.methods} >= {
        "two_dts", "triangle_splatting", "mesh_splatting", "diffsoup"
    }  # fmt: skip
    assert (protocol.chamfer is not None) is (name == "paper")


@pytest.mark.parametrize("other", [["p.toml"], ["--dry-run"], ["--only", "x"], ["--json", "-"], ["-j", "2"]])
def test_an_example_goes_with_nothing_else(msb: Msb, other: list[str]) -> None:
    result = msb("run --example paper", *other)
    result.ends(2, "USAGE: ")
    assert "does not go with --example" in result.err


def test_json_replaces_that_of_a_run_and_nothing_else(here: Here, tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    for text in ("precious", '{"schema": "msb.run/10"}', ""):
        file.write_text(text)
        here("run", "--json", file, tmp_path / "p.toml").ends(
            2, f"OUTPUT_EXISTS: {file}: it exists; msb run "
        )
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
    with pytest.raises(UsageError, match="it exists"):
        output.write_json({"schema": "msb.run/1"})
    assert file.read_text() == "precious"


def test_a_run_names_no_option_that_it_has_not(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    def find_json(*_: object, **__: object) -> None:
        raise UsageError("OUTPUT_EXISTS", f"it exists; {REPLACES}", file="a.json")

    monkeypatch.setattr("msb.bench.run.run_protocol", find_json)
    here("run", ROOT / "data_stubs" / "protocol.toml").ends(
        2,
        "OUTPUT_EXISTS: a.json: it exists; msb run replaces only what its --json wrote; name another file\n",
    )
