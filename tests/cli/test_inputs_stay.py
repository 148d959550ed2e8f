"""No output takes the place of an input: of a part of one, of what one names, of one that a search found."""

from __future__ import annotations

import contextlib
import shutil
import time
from pathlib import Path

import pytest

import msb as library
from msb.cli.output import _LOG, Output
from msb.errors import UsageError
from msb.meshes.files import write_whole
from tests.cli.conftest import Here, Refused, mesh_file
from tests.conftest import ROOT, TETRAHEDRON
from tests.topology.seamed import textured_cube

SCENE = ROOT / "data_stubs" / "scenes" / "nerf_synthetic" / "pebble"
MODEL = ROOT / "data_stubs" / "models" / "pebble" / "two_dts"


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    """Return a folder with an asset in form of a folder, a scene, a link to it, and a checkpoint."""
    library.save(
        library.load(ROOT / "data_stubs" / "splat_like.triasset"), tmp_path / "fa.triasset", form="folder"
    )
    shutil.copytree(SCENE, tmp_path / "sc")
    shutil.copytree(ROOT / "data_stubs" / "checkpoint", tmp_path / "ck")
    (tmp_path / "link").symlink_to("sc")
    return tmp_path


@pytest.mark.parametrize(
    ("line", "file"),
    [
        ("info -q -f --json {file} {at}/ck", "ck/cfg_args"),
        ("audit -q -f --json {file} {at}/fa.triasset", "fa.triasset/manifest.json"),
        ("audit -q -f --json {file} {at}", "fa.triasset/manifest.json"),
        ("convert -f {at}/ck {file}", "ck/old.ply"),
        ("eval -q -f --json {file} {at}/sc/train {at}/sc/test", "sc/test/r_0.png"),
        ("scenes -q -f --json {file} {at}/sc", "sc/transforms_test.json"),
        ("scenes -q -f --json {file} {at}", "sc/transforms_test.json"),
        ("scenes -q -f --json {at}/link/transforms_test.json {at}/sc", "sc/transforms_test.json"),
        ("scenes -q -f --json {file} {at}/link", "sc/transforms_test.json"),
        ("render -q -f --scene {at}/sc -o {at}/sc --camera 0 {model}", "sc/test/r_0.png"),
    ],
)
def test_a_file_in_a_folder_that_is_one_input_is_a_part_of_it(
    refused: Refused, inputs: Path, line: str, file: str
) -> None:
    place = inputs / file
    if not place.exists():
        place.write_bytes(b"mine")
    before = place.read_bytes()
    said = refused(line.format(file=place, at=inputs, model=MODEL))
    assert " is a file of " in said
    assert said.endswith(", an input; an output needs a place of its own")
    assert place.read_bytes() == before


def test_a_new_name_in_an_input_folder_and_an_old_one_beside_inputs_that_were_found_are_free(
    here: Here, inputs: Path
) -> None:
    new, beside = inputs / "fa.triasset" / "report.json", inputs / "q" / "report.json"
    beside.parent.mkdir()
    mesh_file(beside.with_name("a.obj"), *TETRAHEDRON)
    assert here("info", "-q", "-f", "--json", new, inputs / "fa.triasset").status == 0
    for _ in range(2):
        assert here("audit", "-q", "-f", "--json", beside, beside.parent).status == 0
        log = inputs / "fa.triasset" / "log"  # is only added to
        assert here("audit", "-q", "--log-file", log, inputs / "fa.triasset").status == 0
        _LOG.pop().close()


@pytest.mark.parametrize(
    "line",
    [
        "info -q -f --json {at}/ck/info.json {at}/ck",
        "audit -q -f --jsonl {at}/ck/audit.jsonl --csv {at}/ck/audit.csv {at}/ck",
        "convert -q -f {at}/ck {at}/ck/mesh.glb",
        "export -q -f {at}/ck {at}/ck/ck.triasset",
        "render -q -f -o {at}/ck/renders --turntable 1 --size 32x24 {at}/ck",
        "eval -q -f --background black --json {at}/sc/test/a.json {at}/sc/test {at}/sc/test",
        "eval -q -f --background black --csv {at}/sc/test/a.csv {at}/sc/test {at}/sc/test",
    ],
)
def test_what_a_command_wrote_into_an_input_it_writes_again(here: Here, inputs: Path, line: str) -> None:
    for _ in range(2):
        done = here(*line.format(at=inputs).split())
        assert (done.status, done.err) == (0, "")


@pytest.mark.parametrize("name", ["figure.svg", "figure.pdf", "elements.npz", "ck.triasset"])
def test_what_is_made_of_a_model_may_be_made_again_in_its_folder(inputs: Path, name: str) -> None:
    output = Output(force=True)
    output.keep("ASSET", inputs / "ck")
    (inputs / "ck" / name).write_bytes(b"")
    output.check_free(inputs / "ck" / name)


@pytest.mark.parametrize("model", ["sc/ck", "bare"])
def test_pictures_in_a_model_are_drawn_again_in_its_scene_or_of_no_known_method(
    here: Here, inputs: Path, model: str
) -> None:
    shutil.move(inputs / "ck", inputs / "sc" / "ck")
    (inputs / "bare").mkdir()
    state = next((inputs / "sc" / "ck").rglob("*.pt"))
    shutil.copy(state, inputs / "bare" / "model.pt")
    for _ in range(2):
        line = ("-q", "-f", "--scene", inputs / "sc", "--camera", 0, "-o", inputs / model / "renders")
        assert here("render", *line, inputs / model).status == 0


@pytest.mark.parametrize(
    ("line", "file"),
    [
        ("convert -f {at} {file}", "sugarfine_a.obj"),
        ("view -q -f --screenshot {file} {at}", "sugarfine_a.png"),
        ("view -q -f --screenshot {file} {at}", "lut0.png"),
    ],
)
def test_a_mesh_or_picture_that_a_model_consists_of_is_a_part_of_it(
    refused: Refused, tmp_path: Path, line: str, file: str
) -> None:
    write_whole(textured_cube("vertex"), tmp_path / "sugarfine_a.obj")
    if file == "lut0.png":  # of another method
        (tmp_path / file).write_bytes(b"mine")
    before = (tmp_path / file).read_bytes()
    said = refused(line.format(file=tmp_path / file, at=tmp_path))
    assert said.startswith(f"USAGE: {tmp_path / file}: it is a file of ")
    assert (tmp_path / file).read_bytes() == before


def test_a_folder_is_not_replaced_with_an_input_that_a_search_found_in_it(
    refused: Refused, tmp_path: Path
) -> None:
    kept = tmp_path / "q" / "kept"
    kept.mkdir(parents=True)
    mesh = mesh_file(kept / "decimate_50.glb", *TETRAHEDRON)
    said = refused(f"trial -q -f --task decimate --save {kept} {tmp_path / 'q'}")
    assert said == f"USAGE: {kept}: {mesh} lies in it; an output needs a place of its own"
    assert mesh.exists()


@pytest.mark.parametrize("command", ["convert -q -f", "repair -q -f"])
def test_what_a_mesh_file_names_is_an_input_too(
    here: Here, refused: Refused, tmp_path: Path, command: str
) -> None:
    write_whole(textured_cube("vertex"), tmp_path / "out.obj")
    mine = {path: path.read_bytes() for path in tmp_path.iterdir() if path.suffix != ".obj"}
    assert len(mine) == 2
    (tmp_path / "out.obj").rename(tmp_path / "in.obj")
    said = refused(f"{command} {tmp_path / 'in.obj'} {tmp_path / 'out.obj'}")
    assert " names it, which makes it an input" in said
    # The image alone, which only the library of materials names.
    (tmp_path / "out.mtl").rename(tmp_path / "in.mtl")
    text = (tmp_path / "in.obj").read_text().replace("out.mtl", "in.mtl")
    (tmp_path / "in.obj").write_text(text)
    assert " names it, which makes it an input" in refused(
        f"{command} {tmp_path / 'in.obj'} {tmp_path / 'out.obj'}"
    )
    assert {path.read_bytes() for path in tmp_path.iterdir() if path.suffix != ".obj"} == {*mine.values()}
    for _ in range(2):  # its own are replaced
        assert here(*command.split(), tmp_path / "in.obj", tmp_path / "other.obj").status == 0


def test_a_texture_is_not_replaced_by_a_picture(refused: Refused, tmp_path: Path) -> None:
    write_whole(textured_cube("vertex"), tmp_path / "a.obj")
    before = (tmp_path / "a.png").read_bytes()
    said = refused(f"view -q -f --screenshot {tmp_path / 'a.png'} {tmp_path / 'a.obj'}")
    assert said.endswith("ASSET names it, which makes it an input; an output needs a place of its own")
    assert (tmp_path / "a.png").read_bytes() == before


@pytest.mark.parametrize(
    ("name", "text", "is_named"),
    [
        ("a.gltf", '{"uri": "my%20own.png"}', True),
        ("a.glb", '{"images":[{"name" : "my own.png"}]}', False),
        ("a.usdz", "my own.png", False),  # it holds its images
        ("a.obj", "# not my own.png", True),
        ("a.obj", "# not_my own.png, notmy own.png", False),
        ("a.triasset", "my own.png", False),
    ],
)
def test_a_name_in_a_mesh_file_is_a_file_beside_it(
    tmp_path: Path, name: str, text: str, is_named: bool
) -> None:
    (tmp_path / name).write_text(text)
    (tmp_path / "my own.png").write_bytes(b"")
    output = Output(force=True)
    output.keep("IN", tmp_path / name)
    with pytest.raises(UsageError) if is_named else contextlib.nullcontext():
        output.check_unnamed(tmp_path / "my own.png")


def test_a_large_mesh_is_searched_for_a_name_in_no_time(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(b"v 0.123 0.234 0.567\n" * 1_500_000)
    (tmp_path / "b.png").write_bytes(b"")
    output = Output(force=True)
    output.keep("IN", tmp_path / "a.obj")
    start = time.process_time()
    output.check_unnamed(tmp_path / "b.png")
    assert time.process_time() - start < 0.2


def test_a_log_is_not_called_like_an_input(refused: Refused, tmp_path: Path) -> None:
    mesh_file(tmp_path / "a.obj", *TETRAHEDRON)
    said = refused(f"audit -q --log-file {tmp_path}/new/log.obj {tmp_path}")
    assert said == f"USAGE: {tmp_path}/new/log.obj: --log-file: a log is no .obj file; name another"
    assert not (tmp_path / "new").exists()


# --- inputs are counted once ---------------------------------------------------------------------------


def test_an_input_in_two_spellings_is_one(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh_file(tmp_path / "a.obj", *TETRAHEDRON)
    (tmp_path / "hard.obj").hardlink_to(tmp_path / "a.obj")
    monkeypatch.chdir(tmp_path)
    assert here("audit", "-q", "a.obj", tmp_path / "a.obj").out.count("\n") == 1
    assert here("audit", "-q", "a.obj", "hard.obj").out.count("\n") == 3
    assert here("audit", "-q", "missing", "./missing").err.count("\n") == 1
    assert here("audit", "-q", "missing", "other").err.count("\n") == 2
    assert here("audit", "-q", "--fail-fast", "missing", "other").err.count("\n") == 1


def test_a_pattern_lists_no_parts_of_what_it_matches(inputs: Path) -> None:
    from msb.api.inputs import expand

    mesh_file(inputs / "fa.triasset.obj", *TETRAHEDRON)
    shutil.rmtree(inputs / "sc")
    (inputs / "link").unlink()
    found = [str(path.relative_to(inputs)) for path in expand(inputs / "**")]
    assert found == ["ck", "fa.triasset", "fa.triasset.obj"]
