"""`msb demo-data`: the folder with the files of all examples."""

import tomllib
from pathlib import Path

from msb.api.demo import CONTENTS
from msb.base.own_folder import LIST
from tests.cli.conftest import Here, here
from tests.conftest import ROOT

__all__ = ["here"]

STUBS = ROOT / "data_stubs"


def files(folder: Path) -> dict[str, bytes]:
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != LIST)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def shipped() -> dict[str, bytes]:
    return {name: data for name, data in files(STUBS).items() if name.split("/")[0] in CONTENTS}


def test_it_writes_all_data_and_no_script(here: Here, tmp_path: Path) -> None:
    result = here("demo-data", tmp_path / "new" / "demo")
    assert (result.status, result.err) == (0, "")
    assert files(tmp_path / "new" / "demo") == shipped()
    (tmp_path / "empty").mkdir()
    assert here("demo-data", "-q", tmp_path / "empty").status == 0


def test_the_demo_data_is_small_and_complete() -> None:
    assert sum(map(len, shipped().values())) < 8_500_000
    scripts = {path.name for path in (*STUBS.glob("*.py"), *(file.parent for file in STUBS.glob("*/*.py")))}
    assert {path.name for path in STUBS.iterdir()} - scripts - {"__pycache__", "results"} == set(CONTENTS)


def test_the_wheel_gets_what_the_command_writes() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    assert included == ["msb", "viewers/msb_viewers", *(f"data_stubs/{name}" for name in CONTENTS)]
