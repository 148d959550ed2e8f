"""Paths of outputs: devices and pipes, inputs, other outputs, existing files, and files that appear later."""

import contextlib
import json
import os
import shlex
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import msb as library
from msb.base.own_folder import LIST, listed_files
from msb.cli import commands
from msb.cli.output import Output
from msb.errors import MsbError
from tests.cli.conftest import INSTALLED, Here, Msb, Refused, mesh_file, of_installed
from tests.conftest import ROOT, TETRAHEDRON

ASSET = ROOT / "data_stubs" / "splat_like.triasset"
POSIX = pytest.mark.skipif(os.name == "nt", reason="devices and pipes with names are POSIX")


# --- devices and pipes ---------------------------------------------------------------------------------


@contextlib.contextmanager
def reading(pipe: Path) -> Iterator[list[bytes]]:
    """Create a pipe and read from it. After the block the list contains the data."""
    os.mkfifo(pipe)
    data: list[bytes] = []
    reader = threading.Thread(target=lambda: data.append(pipe.read_bytes()), daemon=True)
    reader.start()
    yield data
    reader.join(60)


@POSIX
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_a_device_is_written_through_and_stays(here: Here, tmp_path: Path, force: tuple[str, ...]) -> None:
    null = tmp_path / "null"
    null.symlink_to("/dev/null")
    result = here("info", "-q", *force, "--json", null, ASSET)
    assert (result.status, result.err) == (0, "")
    assert null.is_symlink()
    assert here("audit", "-q", "--json", null, "--csv", null, ASSET).status == 0
    folder = tmp_path / "null.triasset"
    folder.symlink_to("/dev/null")
    here("convert", "-f", "--form", "folder", ASSET, folder).ends(3, "OUTPUT_UNWRITABLE: ")
    assert folder.is_symlink()


@POSIX
def test_a_pipe_gets_the_document_and_an_asset_whose_writer_seeks(here: Here, tmp_path: Path) -> None:
    with reading(tmp_path / "pipe") as data:
        assert here("info", "-q", "--json", tmp_path / "pipe", ASSET).status == 0
    assert json.loads(data[0])["schema"] == "msb.info/1"
    with reading(tmp_path / "pipe.triasset") as data:
        library.save(library.load(ASSET), tmp_path / "pipe.triasset")
    library.save(library.load(ASSET), tmp_path / "file.triasset")
    assert data == [(tmp_path / "file.triasset").read_bytes()]


@pytest.mark.slow
@POSIX
def test_a_descriptor_is_written_from_its_position(tmp_path: Path) -> None:
    log = tmp_path / "log"
    line = f"{sys.executable} -m msb info -q --json /dev/fd/3 {ASSET} 3>>{log} && echo after >>{log}"
    log.write_text("before\n")
    subprocess.run(["bash", "-c", line], check=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})
    first, *document, last = log.read_text().splitlines()
    assert (first, last) == ("before", "after")
    assert json.loads("\n".join(document))["schema"] == "msb.info/1"


@POSIX
def test_dev_stdout_means_standard_output(msb: Msb) -> None:
    assert msb("info", "--json", "/dev/stdout", ASSET).json == msb("info", "--json", "-", ASSET).json
    msb("audit", "--json", "/dev/stdout", "--csv", "-", ASSET).ends(2, "USAGE: --json and --csv")


# --- inputs and other outputs --------------------------------------------------------------------------


def test_two_outputs_to_the_same_file_are_rejected(here: Here, tmp_path: Path) -> None:
    (tmp_path / "o").write_bytes(b"mine")
    (tmp_path / "hard").hardlink_to(tmp_path / "o")
    (tmp_path / "soft").symlink_to("o")
    (tmp_path / "here").symlink_to(".")
    for first, second in (("new", "./new"), ("new", "here/new"), ("o", "hard"), ("o", "soft"), ("o", "o")):
        names = f"{tmp_path}/{first}", f"{tmp_path}/{second}"
        here("audit", "-f", "--json", names[0], "--csv", names[1], ASSET).ends(2, "USAGE: ")
    assert (tmp_path / "o").read_bytes() == b"mine"
    assert not (tmp_path / "new").exists()


def test_an_image_is_not_written_to_the_place_of_the_json(tmp_path: Path, refused: Refused) -> None:
    line = f"render -f --turntable 2 --size 64x64 -o {tmp_path} --json {tmp_path}/00001.png {ASSET}"
    assert refused(line).startswith("USAGE: ")


@pytest.mark.parametrize(
    "line",
    of_installed(
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
    ),
)
@pytest.mark.parametrize("name", ["a.csv", "hard.csv", "soft.csv", "new.csv"])
def test_an_output_that_is_an_input_is_rejected(
    line: str, name: str, tmp_path: Path, refused: Refused
) -> None:
    place = tmp_path / "a.csv"
    if name != "new.csv":  # also for a path that does not exist yet
        place.write_bytes(b"mine")
        (tmp_path / "hard.csv").hardlink_to(place)
        (tmp_path / "soft.csv").symlink_to(place)
    words = [word.format(tmp_path / "a.csv") for word in shlex.split(line)]
    words[max(n for n, word in enumerate(words) if word == str(place))] = str(tmp_path / name)
    if name == "new.csv":
        words = [word.format(tmp_path / name) for word in shlex.split(line)]
    assert refused(words).startswith("USAGE: ")
    assert (place.read_bytes() if place.exists() else None) == (None if name == "new.csv" else b"mine")


@pytest.mark.parametrize(
    "line",
    of_installed(
        "convert -f --to obj {0}/*.obj {0}",
        "audit -q -f --json {0}/a.obj {0}",
        "audit -q -f --elements {0}.csv {0}/*.obj",
        "validate -f --jsonl {0}/link {0}",
    ),
)
def test_an_output_must_not_be_an_input_of_a_folder_or_pattern(
    line: str, tmp_path: Path, refused: Refused
) -> None:
    folder = tmp_path / "q"
    folder.mkdir()
    mesh = mesh_file(folder / "a.obj", *TETRAHEDRON)
    (tmp_path / "q.csv").hardlink_to(mesh)
    (folder / "link").symlink_to(mesh)
    before = mesh.read_bytes()
    assert refused(line.format(folder)).startswith("USAGE: ")
    assert mesh.read_bytes() == before
    assert (folder / "link").is_symlink()


def test_outputs_next_to_the_inputs_of_a_pattern_are_written(here: Here, tmp_path: Path) -> None:
    mesh_file(tmp_path / "a.obj", *TETRAHEDRON)
    for force in ((), ("-f",)):
        assert here("convert", *force, "--to", "ply", tmp_path / "*.obj", tmp_path).status == 0
    assert (tmp_path / "a.ply").exists()


# --- files that exist, or appear while a command runs --------------------------------------------------


def test_an_existing_file_needs_force(here: Here, tmp_path: Path) -> None:
    for option in ("--json", "--csv"):
        (tmp_path / "o").write_text("mine")
        here("audit", option, tmp_path / "o", ASSET).ends(2, "OUTPUT_EXISTS: ")
        assert (tmp_path / "o").read_text() == "mine"
        assert here("audit", "-q", "-f", option, tmp_path / "o", ASSET).status == 0
        assert (tmp_path / "o").read_text() != "mine"
    for force in ((), ("-f",)):
        here("info", *force, "--json", tmp_path, ASSET).ends(3, "OUTPUT_UNWRITABLE: ")
        here("convert", *force, ASSET, tmp_path).ends(2, "USAGE: ")


RUN = "run -o {0} --scene data_stubs/scenes/nerf_synthetic/pebble data_stubs/models/pebble/two_dts"


@pytest.mark.parametrize("line", of_installed(RUN, "scenes {0}"))
def test_a_file_is_not_a_folder(here: Here, tmp_path: Path, line: str) -> None:
    (tmp_path / "file").write_text("mine")
    assert here(line.format(tmp_path / "file")).status == 3
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("line", "file", "names"),
    [
        ("bake {} -o a.glb --lods 0.5 --json a_lod1.glb", "a_lod1.glb", ("--json", "--out")),
        ("bake {} -o a.glb -o a_lod1.glb --lods 0.5", "a_lod1.glb", ("--out a.glb", "--out a_lod1.glb")),
        ("why {} --save why --json why/shading.png", "shading.png", ("--json", "--save")),
    ],
)
def test_two_outputs_with_the_same_file_are_both_named(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, file: str, names: tuple[str, str]
) -> None:
    pytest.importorskip(f"msb.{line.split()[0]}")
    monkeypatch.chdir(tmp_path)
    result = here(*line.format(ASSET).split())
    assert result.status == 2
    assert all(word in result.err for word in (file, *names))
    assert not any(tmp_path.iterdir())


def test_a_link_is_replaced_and_its_target_stays(here: Here, tmp_path: Path) -> None:
    (tmp_path / "target").write_text("mine")
    (tmp_path / "link").symlink_to("target")
    assert here("info", "-q", "-f", "--json", tmp_path / "link", ASSET).status == 0
    assert (tmp_path / "target").read_text() == "mine"
    assert not (tmp_path / "link").is_symlink()


@pytest.mark.parametrize(("line", "name"), [("audit -q --elements", "a.npz"), ("convert {}", "a.triasset")])
def test_a_file_that_appears_during_the_run_is_kept(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, name: str
) -> None:
    out, mesh, check = tmp_path / name, mesh_file(tmp_path / "m.off", *TETRAHEDRON), Output.check_free

    def check_and_lose(output: Output, path: Path | None, **options: Any) -> None:
        check(output, path, **options)
        out.write_text("precious")

    monkeypatch.setattr(Output, "check_free", check_and_lose)
    words = [*line.format(mesh).split(), out, *([mesh] if "{}" not in line else [])]
    result = here(*words)
    assert (result.status, result.err.split(":")[0]) == (2, "OUTPUT_EXISTS")
    assert out.read_text() == "precious"
    out.unlink()
    if "{}" not in line:  # errors in documents name the option, too
        error = here("audit", "-q", "--json", "-", "--elements", out, "missing", mesh).json[1]["error"]
        assert error["code"] == "OUTPUT_EXISTS"
        assert "--force" in error["message"]


# --- folders that a command writes as a whole ----------------------------------------------------------

FOLDERS = of_installed(
    "trial --task decimate_50 --save {out} {mesh}", "repair --compare --task none {mesh} {out}"
)


@pytest.mark.parametrize(
    "line", ["demo-data {out}", *(pytest.param(line, marks=pytest.mark.slow) for line in FOLDERS)]
)
def test_force_replaces_files_of_an_earlier_run_only(here: Here, tmp_path: Path, line: str) -> None:
    if "compare" in line and "trial" not in INSTALLED:
        pytest.skip("msb repair --compare needs msb.trial")
    out, mesh = tmp_path / "out", mesh_file(tmp_path / "m.ply", *TETRAHEDRON)
    words = line.format(out=out, mesh=mesh).split()
    assert here(*words).status == 0
    written = listed_files(out)
    assert written
    here(*words).ends(2, "OUTPUT_EXISTS: ")
    (out / "thesis.tex").write_text("mine")
    changed = out / min(written)
    changed.write_text("changed")
    assert here(*words, "--force").status == 0
    assert changed.read_bytes() != b"changed"
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == {
        *written,
        LIST,
        "thesis.tex",
    }
    (out / LIST).unlink()
    here(*words, "--force").ends(2, "OUTPUT_EXISTS: ")
    file = tmp_path / "file"
    file.write_text("mine")
    here(*line.format(out=file, mesh=mesh).split(), "--force").ends(2, "OUTPUT_EXISTS: ")
    assert file.read_text() == "mine"


@pytest.mark.skipif("trial" not in INSTALLED, reason="msb.trial is not installed")
def test_an_input_among_the_files_of_an_earlier_run_is_protected(here: Here, tmp_path: Path) -> None:
    assert here("demo-data", "-q", tmp_path / "demo").status == 0
    for name in ("splat_like.triasset", "checkpoint"):
        line = ("trial", "--task", "solid", "--force", "--save", tmp_path / "demo", tmp_path / "demo" / name)
        here(*line).ends(2, "USAGE: ")
    shutil.rmtree(tmp_path / "demo" / "models")
    assert (tmp_path / "demo" / "checkpoint").is_dir()


def test_an_asset_in_a_folder_replaces_an_asset_only(here: Here, tmp_path: Path) -> None:
    out, mesh = tmp_path / "a.triasset", mesh_file(tmp_path / "m.ply", *TETRAHEDRON)
    for _ in range(2):
        assert here("convert", "-f", "--form", "folder", mesh, out).status == 0
    (out / "thesis.tex").write_text("mine")
    here("convert", "-f", "--form", "folder", mesh, out).ends(2, "OUTPUT_EXISTS: ")
    (out / "manifest.json").unlink()
    with pytest.raises(MsbError) as caught:
        library.load(ASSET).save(out, form="folder", overwrite=True)
    assert caught.value.code == "OUTPUT_EXISTS"
    assert (out / "thesis.tex").read_text() == "mine"


# --- names ---------------------------------------------------------------------------------------------

WRITTEN = {
    "json_file", "json_lines", "csv_file", "elements", "log_file", "target", "out", "film", "screenshot",
    "figure", "html", "maps", "save", "outputs",
}  # fmt: skip
"""Names of the parameters that are outputs. All other paths are inputs, or folders for files."""


@pytest.mark.parametrize("name", INSTALLED)
def test_the_paths_that_a_command_writes_are_marked(name: str) -> None:
    declared = commands.find(name).declared
    marked = {each for each, parameter in declared.items() if parameter.option.output in ("file", "own")}
    assert declared.keys() & (WRITTEN - {"out", "target"}) <= marked <= WRITTEN


@pytest.mark.parametrize(
    "line",
    of_installed(
        "audit --elements out.triasset a.ply",
        "convert a.ply out.fbx",
        "export a out.glb",
        "render --turntable 2 --film out.avi a.ply",
        "repair a.ply out.gltf",
        "view --figure out.html a.ply",
        "web -o out.glb a.ply",
    ),
)
def test_a_wrong_suffix_is_rejected(line: str, here: Here, tmp_path: Path) -> None:
    mesh_file(tmp_path / "a.ply", *TETRAHEDRON)
    words = [
        str(tmp_path / word) if word in ("a", "a.ply") or "out." in word else word for word in line.split()
    ]
    here(*words).ends(2, "USAGE: ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_a_name_that_is_too_long_is_one_line(here: Here, tmp_path: Path) -> None:
    long = tmp_path / ("x" * 260)
    here("info", "--json", long, ASSET).ends(3, "OUTPUT_UNWRITABLE: ")
    here("demo-data", long).ends(3, "OUTPUT_UNWRITABLE: ")
    assert here("convert", long, tmp_path / "a.ply").status == 3
