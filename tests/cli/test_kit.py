"""Options from dataclasses, help, wrong usage, and commands of other packages."""

import json
import os
import re
import sys
from pathlib import Path

import pytest

from msb.base.packages import PackageWarning
from msb.cli import commands
from msb.cli.commands import BUILT_IN, Entry
from msb.errors import UsageError
from tests.cli.conftest import INSTALLED, Here, Msb, Refused
from tests.cli.forks import run_msb
from tests.conftest import ROOT

ASSET = "data_stubs/splat_like.triasset"

WEIGH = '''
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from msb.base.option import Argument, Option
from msb.cli.command import Typed, command, option_value, require
from msb.cli.output import JsonOutput
from msb.errors import UsageError


@dataclass(frozen=True)
class Scale:
    unit: Annotated[Literal["g", "kg"], Option("Unit of the weight.")] = "g"
    factor: Annotated[float, Option("Factor.", least=0, most=10)] = 1.0
    tags: Annotated[tuple[str, ...], Option("Tags.", ("--tag",))] = ()
    both: Annotated[bool, Option("Both.", ("--both/--no-both", "-b"))] = True
    hidden: int = 3
    left_out: Annotated[int, Option("Not an option of the command.")] = 4


@command("weigh a.ply")
def weigh(
    path: Annotated[Path, Argument("A file.", metavar="FILE")],
    scale: Annotated[Scale, ("unit", "factor", "tags", "both")],
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Weigh a file."""
    if scale.unit == "kg":
        typed.reject(["factor"], "needs grams")
    require("heavy" not in scale.tags, "It is too heavy")
    with option_value("--tag"):
        if "odd" in scale.tags:
            raise UsageError("NAME_UNKNOWN", "it is odd")
    output.write_json({"schema": "weigh/1", "path": str(path), **vars(scale), "typed": typed})
'''


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder in the search path with a package that has the command `weigh-it`."""
    site = tmp_path / "site"
    info = site / "weighing-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "weighing.py").write_text(WEIGH)
    (info / "METADATA").write_text("Name: weighing\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[msb.commands]\nweigh-it = weighing:weigh\n")
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.delitem(sys.modules, "weighing", raising=False)
    return site


# --- options -------------------------------------------------------------------------------------------


def test_fields_become_options_and_the_function_gets_the_object(here: Here, site: Path) -> None:
    plain = here("weigh-it", "--json", "-", "a.ply").json
    values = {"unit": "g", "factor": 1.0, "tags": [], "both": True, "hidden": 3, "left_out": 4}
    assert plain.pop("tool_version")
    assert plain == {
        "schema": "weigh/1",
        "path": "a.ply",
        **values,
        "typed": {"json_file": "--json", "path": "FILE"},
    }
    line = ("--unit", "kg", "--tag", "x", "--tag=y", "--no-both", "--json", "-", "a.ply")
    given = here("weigh-it", *line).json
    assert (given["unit"], given["tags"], given["both"]) == ("kg", ["x", "y"], False)
    assert given["typed"]["tags"] == "--tag"
    assert given["typed"]["both"] == "--both"


@pytest.mark.parametrize(
    ("line", "begin"),
    [
        ("--factor 2 --unit kg a", "USAGE: --factor needs"),
        ("--tag heavy a", "USAGE: It is"),
        ("--tag odd a", "USAGE: --tag: it"),
        ("--factor 11 a", "USAGE: Invalid value"),
        ("--factor x a", "USAGE: Invalid value"),
        ("--unit t a", "USAGE: Invalid value"),
        ("--left-out 3 a", "USAGE: No such option"),
        ("--hidden 3 a", "USAGE: No such option"),
        ("", "USAGE: Missing argument"),
        ("a b", "USAGE: Got unexpected"),
        ("'' ", "USAGE: an argument"),
        ("--tag '' a", "USAGE: an argument"),
        ("--json= a", "USAGE: an argument"),
        ("-- ''", "USAGE: an argument"),
    ],
)
def test_wrong_usage_is_one_line(refused: Refused, site: Path, line: str, begin: str) -> None:
    assert refused(f"weigh-it {line}").startswith(begin)


@pytest.mark.parametrize(
    ("line", "meant"),
    [("audit --jsn x", "--json"), ("rendr", "render"), ("weigh", "weigh-it"), ("info", "usage: msb info")],
)
def test_a_similar_name_and_the_usage_are_shown(refused: Refused, site: Path, line: str, meant: str) -> None:
    assert meant in refused(line)


def test_flags_and_lists_can_be_repeated(here: Here) -> None:
    result = here("audit", "-q", "-q", "-f", "-f", "--fail-on", "faces<1", "--fail-on", "faces<2", ASSET)
    assert (result.status, result.err) == (0, "")


def test_an_error_is_one_line_and_debug_shows_the_traceback(here: Here, tmp_path: Path) -> None:
    name = tmp_path / "a\x1b[31m\nb.ply"
    result = here("audit", name)
    result.ends(3, "FILE_NOT_FOUND: ")
    assert "\x1b" not in result.err
    assert "Traceback" in here("info", "--debug", name).err


def test_empty_words_of_another_program_are_passed_on(here: Here, tmp_path: Path) -> None:
    if "track" not in INSTALLED:
        pytest.skip("msb.bench is not installed")
    code = "import sys; sys.exit(len(sys.argv))"
    assert here("track", "-o", tmp_path / "t.json", "--", sys.executable, "-c", code, "").status == 2


# --- help and the list of commands ---------------------------------------------------------------------


def test_no_command_shows_the_list_under_headings(here: Here) -> None:
    output, helped = here(), here("--help")
    assert (output.status, output.out) == (0, helped.out)
    listed = re.findall(r"^  ([a-z-]+)  +[A-Z]", output.out, re.MULTILINE)
    assert [name for name in listed if name != "--version"] == INSTALLED
    assert here("-h").out == helped.out


@pytest.mark.parametrize("name", INSTALLED)
def test_help_has_examples_and_exit_statuses(here: Here, name: str) -> None:
    text = here(name, "--help").out
    assert text.startswith(f"Usage: msb {name} ")
    assert "\n  Examples:\n" in text
    assert "\n  Exit status: " in text
    assert "{" not in text.partition("Options:")[0]


def test_version_is_one_line(here: Here) -> None:
    version = here("--version")
    assert re.fullmatch(r"msb \d+\.\d+\.\d+ \(triasset 1\.2, numpy \S+, pyopencl \S+\)\n", version.out)
    assert here("audit", "--version").out == version.out


# --- commands of other packages ------------------------------------------------------------------------


def test_a_command_of_another_package_works(site: Path) -> None:
    path = {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT), str(ROOT / "viewers")])}
    listed = run_msb(["--help"], ROOT, path)
    assert re.search(r"^  weigh-it +\S.*weighing", listed.stdout.decode(), re.MULTILINE)
    assert listed.stderr == b""
    assert b"--factor" in run_msb(["weigh-it", "--help"], ROOT, path).stdout
    assert json.loads(run_msb(["weigh-it", "--json", "-", "a"], ROOT, path).stdout)["path"] == "a"


@pytest.mark.parametrize(
    "entry",
    [
        "weigh-it = nothing_there",
        "weigh-it = weighing:no_name",
        "weigh-it = weighing:Scale",
        "weigh-it = json",
        "weigh-it = raising",
    ],
)
def test_a_broken_command_does_not_affect_others(here: Here, site: Path, entry: str) -> None:
    (site / "raising.py").write_text("raise SystemExit(7)\n")
    (site / "weighing-1.0.dist-info" / "entry_points.txt").write_text(f"[msb.commands]\n{entry}\n")
    listed = here("--help")
    assert (listed.status, listed.err) == (0, "")
    assert "weigh-it" in listed.out
    for line in ("weigh-it a", "weigh-it --help"):
        here(*line.split()).ends(2, "PACKAGE_LEFT_OUT: ")
    assert here("info", "-q", ASSET).status == 0


@pytest.mark.parametrize("entry", ["audit = weighing:weigh", "Weigh! = weighing:weigh"])
def test_a_duplicate_or_invalid_name_is_a_warning(site: Path, entry: str) -> None:
    (site / "weighing-1.0.dist-info" / "entry_points.txt").write_text(f"[msb.commands]\n{entry}\n")
    with pytest.warns(PackageWarning, match="PACKAGE_LEFT_OUT"):
        listed = commands.listed()
    assert [name for entries in listed.values() for name in entries] == INSTALLED


def test_a_module_without_a_value_can_be_named(here: Here, site: Path) -> None:
    (site / "weighing-1.0.dist-info" / "entry_points.txt").write_text("[msb.commands]\nweigh-it = weighing\n")
    assert here("weigh-it", "--json", "-", "a").json["path"] == "a"


# --- capabilities that were removed --------------------------------------------------------------------


def test_a_command_of_a_removed_folder_is_not_listed(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    removed = Entry("msb.removed.command", "It was removed.")
    monkeypatch.setitem(BUILT_IN, "Gone", {"removed": removed})
    assert "removed" not in here("--help").out
    here("removed", "x").ends(2, "EXTRA_MISSING: msb removed needs msb.removed")
    with pytest.raises(UsageError):
        commands.find("removed")


def test_a_folder_of_compiled_files_only_counts_as_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "leftover_package" / "__pycache__").mkdir(parents=True)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(BUILT_IN, "Gone", {"removed": Entry("leftover_package.command", "")})
    assert "Gone" not in commands.listed()


# --- completion ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_completion_prints_a_script_for_both_programs(here: Here, shell: str) -> None:
    script = here("completion", shell).out
    assert "_MSB_COMPLETE" in script
    assert "_MSB_AUDIT_COMPLETE" in script


@pytest.mark.slow
def test_the_script_completes_in_bash_and_skips_a_broken_command(msb: Msb, site: Path) -> None:
    (site / "weighing.py").write_text("raise ValueError\n")
    env = {"_MSB_COMPLETE": "complete_bash", "COMP_CWORD": "1", "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
    assert msb(COMP_WORDS="msb va", **env).out.split() == ["validate"]
    assert msb(COMP_WORDS="msb weigh", **env).out.split() == []
