"""Where options get their values: option, variable, project file, user file, default; and who said so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from msb.cli import defaults
from msb.cli.app import app
from msb.errors import UsageError
from tests.cli.conftest import Msb
from tests.conftest import ROOT

COMMANDS = defaults.single_commands(get_command(app))
USER = """
tier = "reference"
background = "white"
[audit]
fail-on = ["components>9"]
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty project folder, and a user who has a file of defaults."""
    for name in ("MSB_DEVICE", "PYOPENCL_CTX"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(defaults, "user_file", lambda: tmp_path / "user" / "msb.toml")
    (tmp_path / "user").mkdir()
    (tmp_path / "user" / "msb.toml").write_text(USER)
    (tmp_path / "project" / "below").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "project" / "below")
    return tmp_path / "project"


def value(command: str, parameter: str) -> Any:
    found = defaults.read_defaults(COMMANDS)[command].get(parameter)
    return None if found is None else (found.value, found.source)


def test_the_stronger_takes_the_place_of_the_weaker(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    user = str(project.parent / "user" / "msb.toml")
    assert value("render", "tier") == value("bench", "tier") == ("reference", user)
    assert value("audit", "fail_on") == (["components>9"], user)
    assert value("info", "verbose") is None
    path = project / "pyproject.toml"
    path.write_text(
        '[tool.msb.render]\ntier = "dedicated"\nfps = 30\ndepth = true\n[tool.msb]\nverbose = 1\n'
    )
    assert value("render", "tier") == ("dedicated", str(path))
    assert value("render", "fps") == ("30", str(path))
    assert value("render", "depth") == (True, str(path))
    assert value("info", "verbose") == (1, str(path))
    assert value("bench", "tier") == ("reference", user)
    nearer = project / "msb.toml"
    nearer.write_text('background = "black"\n')  # in the same folder the one that is ours alone
    assert value("render", "tier") == ("reference", user)
    assert value("render", "background") == ("black", str(nearer))
    monkeypatch.setenv("MSB_BACKGROUND", "#102030")
    monkeypatch.setenv("MSB_RENDER_DEPTH", "no")
    monkeypatch.setenv("MSB_AUDIT_FAIL_ON", "components>1 'faces > 3'")
    assert value("bench", "background") == ("#102030", "MSB_BACKGROUND")
    monkeypatch.setenv("MSB_BENCH_BACKGROUND", "white")
    assert value("bench", "background") == ("white", "MSB_BENCH_BACKGROUND")
    assert value("render", "background") == ("#102030", "MSB_BACKGROUND")
    assert value("render", "depth") == ("no", "MSB_RENDER_DEPTH")
    assert value("audit", "fail_on") == (["components>1", "faces > 3"], "MSB_AUDIT_FAIL_ON")


def test_a_pyproject_without_a_table_of_ours_is_passed_by(project: Path) -> None:
    (project / "msb.toml").write_text("quiet = true\n")
    for text in (
        "[tool.ruff]\n",
        "[tool.poetry.scripts]\nmsb = 'msb.cli:main'\n",
        "msb = 3\n",
        "[msb]\n=",
    ):
        (project / "below" / "pyproject.toml").write_text(text)
        assert defaults.project_file() == project / "msb.toml"


@pytest.mark.parametrize("variable", ["MSB_DEVICE", "PYOPENCL_CTX"])
def test_a_file_does_not_outvote_the_variables_of_devices(
    project: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    (project / "msb.toml").write_text('device = "gpu"\n')
    assert value("bench", "device") == ("gpu", str(project / "msb.toml"))
    monkeypatch.setenv(variable, "0")
    assert value("bench", "device") is None  # msb.cl reads them, and says which it was


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("msb.toml", "tier = ", "it is no TOML"),
        (
            "msb.toml",
            "teir = 'standard'",
            '"teir" is no option that a file can set; did you mean tier or tiers?',
        ),
        ("msb.toml", "[rendr]", '"rendr" is no command that a file can set; did you mean render'),
        ("msb.toml", "[render]\nfail-on = ['x']", '"render.fail-on" is no option'),
        ("msb.toml", "force = true", '"force" is no option that a file can set; it has to be typed'),
        ("msb.toml", "debug = true", '"debug" is no option that a file can set; it has to be typed'),
        (
            "msb.toml",
            "[audit]\njson = 'x.json'",
            '"audit.json" is no option that a file can set; it has to be',
        ),
        ("msb.toml", "[render]\nout = 'x'", '"render.out" is no option'),
        ("msb.toml", "quiet = 1", '"quiet" is 1; it must be true or false'),
        ("msb.toml", "verbose = true", '"verbose" is True; it must be a whole number'),
        ("msb.toml", "[trial]\nmemory = 'big'", '"trial.memory": it is "big"; it must be a valid number'),
        ("msb.toml", "[audit]\nprofile = 'nope'", "\"audit.profile\": 'nope' is not one of 'game'"),
        ("msb.toml", "[render]\nfps = 0", '"render.fps": it is "0"; it must be greater than'),
        ("msb.toml", "tier = 'nope'", "\"tier\": 'nope' is not one of"),
        ("msb.toml", "tier = ['standard']", "it must be a text or number"),
        ("msb.toml", "[audit]\nfail-on = 'components>1'", "it must be a list of texts or numbers"),
        # Our table in a pyproject.toml is found however it is written, also if it is none.
        *(
            ("pyproject.toml", text, '"teir" is no option that a file can set')
            for text in (
                "[tool.msb]\nteir = 1\n",
                "[tool]\nmsb = {teir = 1}\n",
                "[tool]\nmsb.teir = 1\n",
                "[ tool . 'msb' ]\nteir = 1\n",
                "tool = {'msb' = {teir = 1}}\n",
                'tool."msb".teir = 1\n',
            )
        ),
        *(
            ("pyproject.toml", f"[tool]\nmsb = {value}\n", f'"tool.msb" is {value}; it must be a table')
            for value in ("3", "'tier'", "[1, 2]")
        ),
        ("pyproject.toml", "[tool]\nmsb = true\n", '"tool.msb" is True; it must be a table'),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_its_name(
    project: Path, name: str, text: str, message: str
) -> None:
    path = project / name
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        defaults.read_defaults(COMMANDS)
    assert (caught.value.code, caught.value.file) == ("CONFIG_INVALID", str(path))
    assert message in str(caught.value)


def test_no_file_may_say_where_something_is_written() -> None:
    """A project that was downloaded must not be able to replace files of who runs msb in it."""
    for command in COMMANDS.values():
        for key, option in defaults.options(command):
            if key in {"json", "jsonl", "csv", "elements", "out", "log-file", "film", "screenshot", "figure",
                       "html", "save", "maps", "force"}:  # fmt: skip
                assert not defaults.in_files(command, option), f"{command.name} --{key}"


@pytest.mark.slow
def test_commands_take_what_is_set_and_options_are_stronger(
    msb: Msb, demo_asset: Path, tmp_path: Path
) -> None:
    path = tmp_path / "msb.toml"
    path.write_text('[audit]\nprofile = "print"\nquiet = true\n')
    home = {"HOME": str(tmp_path / "nobody"), "XDG_CONFIG_HOME": ""}
    result = msb("audit", demo_asset, cwd=tmp_path, **home)
    assert (result.status, len(result.out.splitlines())) == (1, 1)
    assert "boundary_edges > 0" in result.err
    result = msb("audit", demo_asset, cwd=tmp_path, MSB_AUDIT_PROFILE="research", **home)
    assert "boundary_edge_ratio > 0.45" in result.err
    result = msb("audit", "--profile", "game", demo_asset, cwd=tmp_path, MSB_PROFILE="research", **home)
    assert "nonmanifold_edge_ratio > 0.01" in result.err
    shown = msb("config", "show", cwd=tmp_path, MSB_TIER="dedicated", **home)
    lines = [line.split() for line in shown.out.splitlines()]
    assert ["audit.quiet", "true"] in [line[:2] for line in lines]
    assert ["bench.tier", "dedicated", "MSB_TIER"] in lines
    data = msb("config", "show", "--all", "--json", "-", cwd=tmp_path, **home).json
    assert {"key": "audit.quiet", "value": True, "from": str(path)} in data["settings"]
    assert {"key": "render.tier", "value": "standard", "from": "default"} in data["settings"]
    path.write_text("scale = 0.5\n")  # which needs --cameras where it is typed
    msb("web", "-o", "a.html", demo_asset, cwd=tmp_path, **home, status=0)
    msb("web", "-f", "-o", "a.html", "--scale", "0.5", demo_asset, cwd=tmp_path, **home, status=2)
    path.write_text('[audit]\nprofile = "gmae"\n')
    result = msb("audit", demo_asset, cwd=tmp_path, **home)
    assert (result.status, len(result.err.splitlines())) == (2, 1)
    assert "audit.profile" in result.err
    assert str(path) in result.err
    path.unlink()
    result = msb("info", demo_asset, cwd=tmp_path, MSB_QUIET="perhaps", **home)
    assert (result.status, len(result.err.splitlines())) == (2, 1)
    assert "set by MSB_QUIET" in result.err
    msb("info", demo_asset, cwd=tmp_path, MSB_INFO_QUIET="yes", **home, status=0)


@pytest.mark.slow
def test_msb_audit_reads_the_table_of_audit(tmp_path: Path, demo_asset: Path) -> None:
    import os
    import subprocess
    import sys

    (tmp_path / "msb.toml").write_text('[audit]\nprofile = "print"\n[render]\ntier = "dedicated"\n')
    done = subprocess.run(
        [sys.executable, "-c", "from msb.cli import main_audit; main_audit()", "-q", str(demo_asset)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 1
    assert "GATE_FAILED" in done.stderr


def test_config_alone_shows_its_commands_as_msb_alone_does(msb: Msb) -> None:
    result = msb("config")
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("Usage: msb config")
    assert "  show  " in result.out
