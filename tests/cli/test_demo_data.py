"""`msb demo-data`: the folder with everything that examples name."""

from __future__ import annotations

import tomllib
from pathlib import Path

from msb.api.demo import CONTENTS
from msb.bench.protocol import read_protocol
from tests.cli.conftest import Msb
from tests.conftest import ROOT

STUBS = ROOT / "data_stubs"


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def shipped() -> dict[str, bytes]:
    found = files(STUBS)
    return {name: data for name, data in found.items() if name.split("/")[0] in CONTENTS}


def test_it_writes_all_data_and_no_script(msb: Msb, tmp_path: Path) -> None:
    result = msb("demo-data", "new/demo", cwd=tmp_path)
    assert (result.status, result.err) == (0, "")
    assert files(tmp_path / "new" / "demo") == shipped()
    assert "next: msb audit new/demo/splat_like.triasset" in result.out
    assert read_protocol(tmp_path / "new/demo/protocol.toml").results == tmp_path / "new" / "demo" / "results"


def test_it_is_small_enough_for_a_wheel_and_all_of_the_stubs_that_is_data() -> None:
    assert sum(map(len, shipped().values())) < 8_000_000
    scripts = {path.name for path in (*STUBS.glob("*.py"), *(file.parent for file in STUBS.glob("*/*.py")))}
    assert {path.name for path in STUBS.iterdir()} - scripts - {"__pycache__", "results"} == set(CONTENTS)


def test_the_wheel_gets_what_the_command_writes() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    assert included == ["msb", "viewers/msb_viewers", *(f"data_stubs/{name}" for name in CONTENTS)]


def test_an_empty_folder_is_filled_and_another_is_left_alone(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    msb("demo-data", "-q", tmp_path / "empty", status=0)
    msb("demo-data", tmp_path / "empty").ends(
        2, f"OUTPUT_EXISTS: {tmp_path / 'empty'}: it exists; --force replaces it"
    )
    (tmp_path / "empty" / "views.json").write_text("{}")
    (tmp_path / "empty" / "results").mkdir()
    msb("demo-data", "-q", "--force", tmp_path / "empty", status=0)
    assert files(tmp_path / "empty") == shipped()
    (tmp_path / "empty" / "thesis.tex").write_text("all of it")
    msb("demo-data", "--force", tmp_path / "empty").ends(
        2, f"OUTPUT_EXISTS: {tmp_path / 'empty'}: it holds more than demo data"
    )
    assert files(tmp_path / "empty") == {**shipped(), "thesis.tex": b"all of it"}


def test_help_pages_say_where_the_files_of_their_examples_come_from(msb: Msb) -> None:
    assert "msb demo-data data_stubs" in msb("render", "--help").out
    assert "msb demo-data" not in msb("completion", "--help").out
