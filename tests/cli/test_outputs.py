"""What may stand where an output goes: devices, pipes, other outputs, inputs, and what comes meanwhile."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msb.cli.defaults import single_commands
from typer.main import get_command

import msb as library
from msb.base.atomic import new_folder
from msb.cli.app import app
from msb.cli.output import Output, echo
from msb.errors import OutputError, UsageError
from tests.cli.conftest import Here, Msb, Refused, Result, mesh_file
from tests.conftest import ROOT, TETRAHEDRON
from tests.report.factory import write_results

ASSET = ROOT / "data_stubs" / "splat_like.triasset"
POSIX = pytest.mark.skipif(os.name == "nt", reason="devices and pipes with names are POSIX")
SOURCE = ROOT / "tests" / "golden" / "meshes" / "synthetic_splat_small.ply"


@contextlib.contextmanager
def reading(pipe: Path) -> Iterator[list[bytes]]:
    """Make a pipe; yield a list that has what its reader got when the block has ended."""
    os.mkfifo(pipe)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    yield got
    reader.join(60)


# --- devices and pipes ---------------------------------------------------------------------------------


@POSIX
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_a_device_is_written_through_and_stays(msb: Msb, tmp_path: Path, force: tuple[str, ...]) -> None:
    (tmp_path / "null").symlink_to("/dev/null")
    result = msb("info", "-q", *force, "--json", tmp_path / "null", ASSET)
    assert (result.status, result.err) == (0, "")
    assert (tmp_path / "null").is_symlink()
    assert Path("/dev/null").is_char_device()


@POSIX
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_a_pipe_gets_what_its_reader_waits_for(msb: Msb, tmp_path: Path, force: tuple[str, ...]) -> None:
    pipe = tmp_path / "pipe"
    with reading(pipe) as got:
        msb("info", "-q", *force, "--json", pipe, ASSET, status=0)
    assert json.loads(got[0])["schema"] == "msb.info/1"
    assert pipe.is_fifo()


@POSIX
def test_an_asset_can_be_written_through_a_pipe_though_its_writer_seeks(tmp_path: Path) -> None:
    with reading(tmp_path / "pipe.triasset") as got:
        library.save(library.load(ASSET), tmp_path / "pipe.triasset")
    library.save(library.load(ASSET), tmp_path / "file.triasset")
    assert got == [(tmp_path / "file.triasset").read_bytes()]


@pytest.mark.slow
@POSIX
def test_descriptors_go_on_where_they_are(tmp_path: Path) -> None:
    log = tmp_path / "log"
    line = f"{sys.executable} -m msb info -q --json /dev/fd/3 {ASSET} 3>>{log} && echo after >>{log}"
    log.write_text("before\n")
    subprocess.run(["bash", "-c", line], check=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})
    first, *document, last = log.read_text().splitlines()
    assert (first, last) == ("before", "after")
    assert json.loads("\n".join(document))["schema"] == "msb.info/1"


@pytest.mark.slow
@POSIX
def test_the_systems_name_of_standard_output_means_it(msb: Msb) -> None:
    assert msb("info", "--json", "/dev/stdout", ASSET).json == msb("info", "--json", "-", ASSET).json
    result = msb("audit", "--json", "/dev/stdout", "--csv", "-", ASSET)
    assert (result.status, result.err) == (2, "USAGE: --json and --csv cannot both go to standard output\n")


@POSIX
def test_a_folder_is_not_written_onto_a_device(msb: Msb, tmp_path: Path) -> None:
    null = tmp_path / "null.triasset"
    null.symlink_to("/dev/null")
    result = msb("convert", "-f", "--form", "folder", ASSET, null)
    assert (result.status, result.out) == (3, "")
    assert result.err == f"OUTPUT_UNWRITABLE: {null}: it is a device or pipe; a folder is to be written\n"
    with pytest.raises(OutputError, match="a device or pipe"), new_folder(null):
        pass
    assert null.is_symlink()


# --- places that are taken within one command ----------------------------------------------------------


@pytest.mark.slow
def test_two_outputs_into_one_file_are_refused_however_they_are_spelled(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "o").write_bytes(b"mine")
    (tmp_path / "hard").hardlink_to(tmp_path / "o")
    (tmp_path / "soft").symlink_to("o")
    (tmp_path / "here").symlink_to(".")
    for first, second in (("new", "./new"), ("new", "here/new"), ("o", "hard"), ("o", "soft"), ("o", "o")):
        result = msb("audit", "-f", "--json", first, "--csv", second, ASSET, cwd=tmp_path)
        text = f"{second}: --csv and --json name the same file; an output needs a place of its own\n"
        assert (result.status, result.out, result.err) == (2, "", f"USAGE: {Path(text)}")
    assert (tmp_path / "o").read_bytes() == b"mine"
    assert not (tmp_path / "new").exists()
    (tmp_path / "null").symlink_to("/dev/null")
    msb("audit", "-q", "--json", "null", "--csv", "null", ASSET, cwd=tmp_path, status=0)


@pytest.mark.parametrize(
    "line",
    [
        "audit -f --elements {0} {0}",
        "audit -f --log-file {0} {0}",
        "bake -f -o {0} {0}",
        "bench -f --json {0} --compare {0} asset",
        "convert -f {0} {0}",
        "eval -f --csv {0} {0} {0}",
        "export -f {0} {0}",
        "info -f --json {0} {0}",
        "render -f --film a.gif --cameras {0} --json {0} asset",
        "repair -f -o {0} {0}",
        "repair -f --maps {0} -o a.ply {0}",
        "report -f --published {0} --json {0} results",
        "run --scene {0} --json {0} asset",
        "validate -f --jsonl {0} --log-file {0} asset",
        "view -f --html {0} {0}",
    ],
)
def test_an_output_that_is_an_input_is_refused(line: str, tmp_path: Path, refused: Refused) -> None:
    place = tmp_path / "a.csv"
    for content in (None, b"mine"):
        if content is not None:
            place.write_bytes(content)
        assert "name the same file; an output needs a place of its own" in refused(line.format(place))
        assert (place.read_bytes() if place.exists() else None) == content


@pytest.mark.parametrize(
    "line",
    [
        "convert -f --to obj {0}/*.obj {0}",
        "audit -q -f --json {0}/a.obj {0}",
        "audit -q -f --elements {0}.csv {0}/*.obj",
        "validate -f --jsonl {0}/link {0}",
        "bake -f --lods 0.5 -o {0}/x.glb {0}/x_lod1.glb",
    ],
)
def test_an_output_is_no_input_of_a_folder_or_pattern(line: str, tmp_path: Path, refused: Refused) -> None:
    q = tmp_path / "q"
    q.mkdir()
    mesh = mesh_file(q / "a.obj", *TETRAHEDRON)
    (tmp_path / "q.csv").hardlink_to(mesh)
    (q / "link").symlink_to(mesh)
    baked = q / "x_lod1.glb"
    if "glb" in line:
        mesh_file(baked, *TETRAHEDRON)
    before = mesh.read_bytes(), baked.exists() and baked.read_bytes()
    assert refused(line.format(q)).endswith(": it is an input; an output needs a place of its own")
    assert (mesh.read_bytes(), baked.exists() and baked.read_bytes()) == before


def test_outputs_beside_the_inputs_of_a_pattern_are_written(here: Here, tmp_path: Path) -> None:
    mesh_file(tmp_path / "a.obj", *TETRAHEDRON)
    for force in ((), ("-f",)):
        assert here("convert", *force, "--to", "ply", tmp_path / "*.obj", tmp_path).status == 0
    assert (tmp_path / "a.ply").exists()


# --- what comes while a command runs -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("info --json {out} {mesh}", "a.json"),
        ("audit -q --csv {out} {mesh}", "a.csv"),
        ("audit -q --elements {out} {mesh}", "a.npz"),
        ("convert {mesh} {out}", "a.ply"),
        ("convert {mesh} {out}", "a.triasset"),
        ("convert --form folder {mesh} {out}", "a.triasset"),
        ("export --form folder data_stubs/checkpoint {out}", "a.triasset"),
        ("repair {mesh} {out}", "a.triasset"),
        ("repair {mesh} {out}", "a.ply"),
        ("repair --maps {out} {mesh} {out}.ply", "a.npz"),
        ("repair --compare --task none {mesh} {out}", "pictures"),
        ("trial --task decimate --save {out} {mesh}", "kept"),
        ("report --paper --format csv -o {out}", "paper"),
        ("web --tier dedicated --no-verify -o {out} data_stubs/models/pebble/two_dts", "a.html"),
    ],
)
def test_what_another_program_wrote_meanwhile_is_kept(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, name: str
) -> None:
    out, mesh, check = tmp_path / name, mesh_file(tmp_path / "m.off", *TETRAHEDRON), Output.check_free

    def check_and_lose(output: Output, path: Path | None, *, folder: bool = False) -> None:
        check(output, path, folder=folder)
        if path == out:
            out.write_text("precious")

    monkeypatch.setattr(Output, "check_free", check_and_lose)
    result = here(*line.format(out=out, mesh=mesh).split())
    said = f"OUTPUT_EXISTS: {out}: it exists; --force replaces it\n"
    assert (result.status, result.err[-len(said) :]) == (2, said), result
    assert out.read_text() == "precious"


@pytest.mark.parametrize(
    "line",
    [
        "repair --compare --task none {mesh} {out}",
        "trial --save {out} {mesh}",
        "trial --json - --save {out} {mesh}",
    ],
)
def test_what_came_into_an_empty_folder_is_kept_and_what_was_measured_is_said(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    out, mesh = tmp_path / "out", mesh_file(tmp_path / "m.off", *TETRAHEDRON)
    out.mkdir()

    def measure(*_: object, **__: object) -> Any:
        (out / "theirs").write_text("precious")
        # As it is found if the file comes a moment later.
        monkeypatch.setattr("msb.base.atomic._is_empty", lambda _: True)
        one = {"outcome": "works", "seconds": 1.0, "says": "", "why": "", "files": ["a.glb"]}
        trial = SimpleNamespace(task="uv", title="the table", **one)
        cameras, counts = {"views": "round it"}, {"vertices": 4, "faces": 4}
        data = {"schema": "msb.trial/1", "said": "the table"}
        return SimpleNamespace(trials=[trial], cameras=cameras, mesh=counts, to_dict=lambda: data)

    monkeypatch.setattr("msb.trial.run.try_asset", measure)
    monkeypatch.setattr("msb.trial.repairs.compare", measure)
    monkeypatch.setattr("msb.trial.repairs.document", lambda *_: {})
    monkeypatch.setattr("msb.repair.command._print", lambda *_: echo("the table"))
    result = here(*line.format(out=out, mesh=mesh).split())
    said = f"OUTPUT_EXISTS: {out}: it exists; --force replaces it\n"
    assert (result.status, result.err[-len(said) :]) == (2, said), result
    assert "the table" in result.out
    assert "kept in" not in result.out
    assert [path.name for path in out.iterdir()] == ["theirs"]


def test_what_came_into_a_report_meanwhile_is_kept(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = ("report", "--paper", "--format", "csv", "-o", tmp_path / "out")
    (tmp_path / "out").mkdir()
    assert here(*line).status == 0
    assert here(*line).status == 0

    def make(*_: object, **__: object) -> dict[str, bytes]:
        (tmp_path / "out" / "mine.txt").write_text("precious")
        return {}

    monkeypatch.setattr("msb.report.pages.report_files", make)
    here(*line).ends(2, f"OUTPUT_EXISTS: {tmp_path / 'out'}: the report also holds mine.txt")
    assert (tmp_path / "out" / "mine.txt").exists()


def test_an_error_in_json_names_the_option_of_the_command(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, mesh, check = tmp_path / "a.csv", mesh_file(tmp_path / "m.off", *TETRAHEDRON), Output.check_free

    def check_and_lose(output: Output, path: Path | None, *, folder: bool = False) -> None:
        check(output, path, folder=folder)
        out.write_text("precious")

    monkeypatch.setattr(Output, "check_free", check_and_lose)
    result = here("audit", "-q", "--json", "-", "--elements", out, "missing", mesh)
    assert result.json[1]["error"] == {"code": "OUTPUT_EXISTS", "message": "it exists; --force replaces it"}


def test_a_bake_and_a_submission_keep_it_too(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def save(*_: Path, overwrite: bool) -> None:
        raise UsageError("USAGE", f"overwrite is {overwrite}")

    monkeypatch.setattr("msb.bake.bake", lambda *_, **__: SimpleNamespace(save=save))
    for force in (False, True):
        done = here("bake", *["-f"] * force, "-o", tmp_path / "a.glb", ASSET)
        done.ends(2, f"USAGE: overwrite is {force}")
    results, out = write_results(tmp_path / "run", datasets=["tanksandtemples"]), tmp_path / "a.zip"

    def write_meanwhile(*_: object, **__: object) -> bytes:
        out.write_text("precious")
        return b"zip"

    monkeypatch.setattr("msb.bench.submission.write_submission", write_meanwhile)
    here("submit", results, "-o", out, "--name", "us").ends(2, f"OUTPUT_EXISTS: {out}: ")
    assert out.read_text() == "precious"


@pytest.mark.parametrize(
    ("line", "own"),
    [
        ("trial -f --task decimate --save {out} {mesh}", "decimate_50.png"),
        ("repair -f --compare --task none {mesh} {out}", "orient-pair.png"),
        ("convert -f --form folder {mesh} {out}", "manifest.json"),
    ],
)
def test_of_a_folder_only_what_the_command_wrote_is_replaced(
    here: Here, tmp_path: Path, line: str, own: str
) -> None:
    home, out = tmp_path / "home.triasset", tmp_path / "out.triasset"
    home.mkdir()
    out.mkdir()
    mesh = mesh_file(home / "m.ply", *TETRAHEDRON)

    def run(mesh: Path = mesh, out: Path = out) -> Result:
        return here(*line.format(mesh=mesh, out=out).split())

    for _ in range(2):
        assert run().status == 0
        assert (out / own).exists()
    run(out=home).ends(2, f"USAGE: {home}: {'IN' if own == 'manifest.json' else 'ASSET'} lies in it")
    link, notes = tmp_path / "link.triasset", out / "notes.txt"
    link.symlink_to(out)
    notes.write_text("mine")
    for place in (out, link):
        run(out=place).ends(2, f"OUTPUT_EXISTS: {place}: it holds notes.txt, which no ")
    notes.unlink()
    inside = mesh_file(out / "m.ply", *TETRAHEDRON)
    run(inside).ends(2, f"USAGE: {out}: ")
    run(inside, link).ends(2, f"USAGE: {link}: ")
    assert link.is_symlink()
    assert (out / own).exists()
    assert inside.exists()


@pytest.mark.parametrize(
    "line", ["trial -f --task solid --save {file} {mesh}", "repair -f --compare --task none {mesh} {file}"]
)
def test_a_file_becomes_no_folder(here: Here, tmp_path: Path, line: str) -> None:
    mesh, file = mesh_file(tmp_path / "m.ply", *TETRAHEDRON), tmp_path / "file"
    file.write_text("mine")
    here(*line.format(mesh=mesh, file=file).split()).ends(2, f"OUTPUT_EXISTS: {file}: it is a file")
    assert file.read_text() == "mine"


@pytest.mark.parametrize(
    "line", ["trial --save {name} {mesh}", "convert --form folder {mesh} {name}.triasset"]
)
def test_a_folder_of_a_name_too_long_is_one_line(here: Here, tmp_path: Path, line: str) -> None:
    words = line.format(mesh=mesh_file(tmp_path / "m.ply", *TETRAHEDRON), name=tmp_path / ("n" * 300))
    here(*words.split()).ends(3, "OUTPUT_UNWRITABLE: ")


def test_a_folder_where_a_file_is_to_be_written_is_called_one(here: Here, tmp_path: Path) -> None:
    mesh, folder = mesh_file(tmp_path / "m.ply", *TETRAHEDRON), tmp_path / "f.json"
    folder.mkdir()
    (tmp_path / "plain").mkdir()
    for force in ((), ("-f",)):
        here("info", *force, "--json", folder, mesh).ends(3, f"OUTPUT_UNWRITABLE: {folder}: it is a folder")
        here("convert", *force, mesh, tmp_path / "plain").ends(
            2, 'USAGE: OUT is "plain", a folder; it must end in one of .triasset, '
        )


def test_an_asset_replaces_no_folder_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "a.triasset").mkdir()
    (tmp_path / "a.triasset" / "thesis.tex").write_text("mine")
    with pytest.raises(UsageError, match=r"it holds thesis\.tex"):
        library.load(ASSET).save(tmp_path / "a.triasset", form="folder", overwrite=True)


def test_an_image_is_not_written_where_the_json_goes(tmp_path: Path, refused: Refused) -> None:
    line = f"render -f --turntable 2 --size 64x64 -o {tmp_path} --json {tmp_path}/00001.png {ASSET}"
    assert (
        refused(line) == f"USAGE: {tmp_path}/00001.png: two outputs would be written to it; give each its own"
    )


# --- paths and options ---------------------------------------------------------------------------------

GROUP: Any = get_command(app)
COMMANDS: dict[str, Any] = dict(single_commands(GROUP))
COMMANDS["config show"] = GROUP.get_command(None, "config").commands["show"]
WRITTEN = {
    "json_file", "json_lines", "csv_file", "elements", "log_file", "target", "out", "film", "screenshot",
    "figure", "html", "maps", "save", "outputs",
}  # fmt: skip
"""What commands write; all other paths are read, or are folders for files."""


def test_what_is_written_is_marked_so() -> None:
    for command in COMMANDS.values():
        declared = command.callback.declared.values()
        marked = {each.name for each in declared if each.option.output in ("file", "own")}
        named = {param.name for param in command.params} & (WRITTEN - {"out", "target"})
        assert named <= marked <= WRITTEN


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_an_empty_path_is_refused_by_name_and_is_not_the_current_folder(name: str, refused: Refused) -> None:
    for param in COMMANDS[name].params:
        if not COMMANDS[name].callback.declared[param.name].is_path:
            continue
        if param.param_type_name == "option":
            shown, words = param.opts[0], [param.opts[0], "", "a"]
        else:
            before = [one for one in COMMANDS[name].params if one.param_type_name == "argument"]
            shown = param.metavar.rstrip(".")
            words = ["" if one is param else "a" for one in before]
        text = refused([*name.split(), *words])
        assert text.startswith(
            f"USAGE: {shown} is empty, which names no file; . is the current folder (usage: "
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_an_option_of_one_value_is_not_taken_twice(name: str, refused: Refused) -> None:
    for param in COMMANDS[name].params:
        if param.param_type_name == "argument" or param.is_flag or param.count or param.multiple:
            continue
        words = [param.opts[-1], "a", f"{param.opts[0]}=b"]
        long = next(flag for flag in param.opts if flag.startswith("--"))
        text = refused([*name.split(), *words])
        assert text.startswith(f"USAGE: {long} is given 2 times; it takes one value (usage: msb ")


def test_flags_and_lists_may_be_given_again(msb: Msb) -> None:
    result = msb("audit", "-q", "-q", "-f", "-f", "--fail-on", "faces<1", "--fail-on", "faces<2", ASSET)
    assert (result.status, result.err) == (0, "")


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("export a out.glb", "; it must end in .triasset; for a mesh file: msb convert"),
        ("convert a.ply out.fbx", ".usdz; .glb is opened by Blender and by every engine"),
        ("repair a.ply out.gltf", ".usdz; .glb is opened by Blender and by every engine"),
        ("export a out.usdz", "opened by Blender and by every engine: msb convert writes it"),
        ("convert a.ply out.html", ".usdz; for a page: msb web"),
        ("web -o out.glb a.ply", ".htm; for a mesh file: msb convert"),
        ("audit --elements out.triasset a.ply", ".npz; for an asset: msb export or msb convert"),
        ("view --figure out.html a.ply", ".pdf; for a page: msb web"),
    ],
)
def test_a_wrong_ending_names_the_command_that_writes_what_it_ends_in(
    line: str, hint: str, msb: Msb, tmp_path: Path
) -> None:
    (tmp_path / "a.ply").write_bytes(SOURCE.read_bytes())
    assert msb(line, cwd=tmp_path, status=2).err.endswith(f"{hint}\n")
