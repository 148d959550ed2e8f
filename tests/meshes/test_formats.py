"""Check all formats. Every command supports the example format of CONTRIBUTING.md once it is registered."""

import json
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import msb
from fuzz.targets import mesh_target
from msb.adapters.locate import locate
from msb.cli.app import app
from msb.errors import InputError, MeshFileError
from msb.meshes import Mesh, read_mesh, write_mesh
from msb.meshes.formats import FORMATS, OURS, Format
from tests.conftest import ROOT
from tests.test_docs_commands import blocks

from .builders import SMALL, SQUARE, SQUARE_FACES, SUFFIXES
from .checks import check_format

CORNERS = np.array(SQUARE)[np.array(SQUARE_FACES)].reshape(-1, 3)


TRIANGLES = {title: np.array(SQUARE)[np.array(SQUARE_FACES)] for title in ("PLY", "OFF", "GLB", "glTF")}
TRIANGLES["OBJ"] = np.array(SQUARE)[[[0, 1, 2], [0, 2, 3]]]
TRIANGLES["STL"] = np.array(SQUARE)[[[0, 1, 2], [1, 2, 3]]]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_matches_its_declaration(suffix: str, tmp_path: Path) -> None:
    form = FORMATS[suffix]
    check_format(form, SMALL[suffix], TRIANGLES[form.title], tmp_path)


@pytest.fixture
def tri(monkeypatch: pytest.MonkeyPatch) -> Format:
    """Register the example format of CONTRIBUTING.md."""
    (text,) = (block for block in blocks("CONTRIBUTING.md", "python") if "FORMAT = " in block)
    module = ModuleType("msb.meshes.tri")
    exec(text, vars(module))
    monkeypatch.setitem(OURS, ".tri", module.FORMAT)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    form: Format = module.FORMAT
    return form


def run(*words: object) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.slow
def test_an_added_format_is_converted_audited_and_exported(tri: Format, tmp_path: Path) -> None:
    source, target = tmp_path / "a.off", tmp_path / "b.tri"
    source.write_bytes(SMALL[".off"])
    run("convert", source, target)
    np.testing.assert_array_equal(read_mesh(target).vertices, CORNERS)
    assert json.loads(run("audit", "--json", "-", target))["counts"]["faces"] == 2
    assert [line for line in run("audit", tmp_path).splitlines() if "b.tri" in line]
    run("convert", target, tmp_path / "c.triasset")
    assert len(msb.load(tmp_path / "c.triasset").buffers["indices"]) == 2
    assert locate(target).kind == "mesh"


def test_the_example_test_of_contributing_passes(tri: Format, tmp_path: Path) -> None:
    (text,) = (block for block in blocks("CONTRIBUTING.md", "python") if "check_format(" in block)
    names: dict[str, Any] = {}
    exec(text, names)
    names["test_tri"](tmp_path)


def test_an_added_format_is_recognised_by_its_content(tri: Format, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"tri\n0 0 0 1 0 0 1 1 0\n")
    with pytest.raises(MeshFileError, match=r"MESH_FILE_INVALID: .*TRI"):
        read_mesh(tmp_path / "a.ply")
    (tmp_path / "a.xyz").touch()
    with pytest.raises(InputError, match=r"FILE_NOT_RECOGNISED.*\.tri"):
        read_mesh(tmp_path / "a.xyz")


def test_an_added_format_is_fuzzed(tri: Format, tmp_path: Path) -> None:
    target = mesh_target(".tri")
    (seed,) = target.seeds()
    feed = target.at(tmp_path)
    assert feed(seed) is None
    assert feed(seed[:-5]).code == "MESH_FILE_INVALID"


def test_a_read_only_format_cannot_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(OURS, ".old", Format("OLD", (".old",), FORMATS[".off"].read))
    (tmp_path / "a.old").write_bytes(SMALL[".off"])
    assert len(read_mesh(tmp_path / "a.old").faces) == 2
    with pytest.raises(InputError, match="FILE_NOT_RECOGNISED"):
        write_mesh(Mesh(np.array(SQUARE), np.array(SQUARE_FACES)), tmp_path / "b.old", suffix=".old")
    done = CliRunner().invoke(app, ["convert", str(tmp_path / "a.old"), str(tmp_path / "b.old")])
    assert str(done.exception).startswith("USAGE: ")


def test_every_format_is_documented_and_has_a_small_test_file() -> None:
    text = (ROOT / "docs" / "meshes.md").read_text()
    read, written = (text.split(f"\n## {what}\n")[1].split("\n## ")[0] for what in ("Reading", "Writing"))
    assert set(re.findall(r"^\| (glTF|[A-Z]+) \|", read, re.MULTILINE)) == {f.title for f in FORMATS.values()}
    writers = {form.title for form in FORMATS.values() if form.write is not None}
    assert set(re.findall(r"^\| ([A-Z]+) \|", written, re.MULTILINE)) == writers
    assert set(SUFFIXES) <= set(SMALL)
