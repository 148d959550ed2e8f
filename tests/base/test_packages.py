"""Packages that exit, interrupt, print or hold the wrong thing: commands keep status and output."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import msb
from msb.base.packages import PackageError, PackageWarning, contained, load
from msb.render.backend import BUILT_IN, ENGINES, renderers, what_is_missing
from tests.cli.conftest import Msb
from tests.cli.conftest import msb as msb_command
from tests.conftest import ROOT

__all__ = ["msb_command"]
CAMERA = msb.Camera.look_at((0, 0, 3), (0, 0, 0), up=(0, 1, 0), width=8, height=6, fov_y=0.9)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Path]]:
    """Install modules, and entry points as they stand in their file."""
    monkeypatch.syspath_prepend(tmp_path)

    def forget() -> None:
        renderers.cache_clear()
        for name in [name for name in sys.modules if name.startswith("their_")]:
            del sys.modules[name]

    def install(entries: str, **modules: str) -> Path:
        forget()
        info = tmp_path / "theirs-1.0.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entries)
        for name, text in modules.items():
            (tmp_path / f"{name}.py").write_text(text)
        return tmp_path

    yield install
    monkeypatch.undo()
    forget()


WAYS = {
    "import nothing_of_that_name": "ModuleNotFoundError",
    "import sys; sys.exit()": "SystemExit",
    "import sys; sys.exit('no CUDA')": "SystemExit: no CUDA",
    "raise KeyboardInterrupt": "KeyboardInterrupt",
    "class Mine(BaseException): pass\nraise Mine('x')": "Mine: x",
    "def (": "SyntaxError",
    "pass": "AttributeError",
}


@pytest.mark.parametrize(("text", "why"), WAYS.items())
def test_what_cannot_be_loaded_is_a_package_error(package: Callable[..., Path], text: str, why: str) -> None:
    package("", their_part=text)
    with pytest.raises(PackageError, match=f"^it cannot be loaded: {why}"):
        load("their_part:Part")


def test_ctrl_c_while_a_package_loads_still_interrupts(package: Callable[..., Path]) -> None:
    text = f"import os\ntry:\n    os.kill(os.getpid(), {int(signal.SIGINT)})\n    [0 for _ in range(10**6)]\n"
    package("", their_part=text + "except KeyboardInterrupt:\n    raise SystemExit from None\n")
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        load("their_part")
    assert signal.getsignal(signal.SIGINT) is before


def test_handlers_that_a_package_sets_are_put_back(package: Callable[..., Path]) -> None:
    package("", their_part="import signal\nsignal.signal(signal.SIGINT, signal.SIG_DFL)\n")
    before = signal.getsignal(signal.SIGINT)
    load("their_part")
    assert signal.getsignal(signal.SIGINT) is before


def test_what_a_package_prints_is_one_warning_and_no_result(
    package: Callable[..., Path], capfd: pytest.CaptureFixture[str]
) -> None:
    package("", their_part="import os\nprint('hello')\nos.system('echo child')\n")
    with pytest.warns(PackageWarning, match='^PACKAGE_PRINTS: module their_part prints "hello"') as caught:
        load("their_part")
    assert len(caught) == 1
    assert capfd.readouterr().out == ""
    with contained():
        print("later")
    assert capfd.readouterr() == ("", "later\n")


def test_of_two_packages_of_one_name_the_first_in_the_alphabet_is_taken(
    package: Callable[..., Path],
) -> None:
    package("[msb.renderers]\nx = their_b:X\nx = their_a:X\nstandard = their_c:X\n")
    with pytest.warns(PackageWarning) as caught:
        found = renderers()
    assert found == {**BUILT_IN, **ENGINES, "x": "their_a:X"}
    assert [str(one.message).partition(" is left out: ")[::2] for one in caught] == [
        (
            "PACKAGE_LEFT_OUT: renderer standard of package their_c",
            f"the name is taken by {BUILT_IN['standard']}, which is part of msb",
        ),
        (
            "PACKAGE_LEFT_OUT: renderer x of package their_b",
            "the name is taken by their_a:X, the first in the alphabet; uninstall one of them",
        ),
    ]


def test_an_entry_point_file_that_cannot_be_read_hides_no_other(
    package: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package("[msb.renderers]\nno equals sign\n")
    other = tmp_path / "other" / "good-1.0.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Name: good\n")
    (other / "entry_points.txt").write_text("[msb.renderers]\nx = their_a:X\n")
    monkeypatch.syspath_prepend(other.parent)
    with pytest.warns(PackageWarning, match="renderers of package theirs .* cannot be read"):
        assert renderers() == {**BUILT_IN, **ENGINES, "x": "their_a:X"}


RENDERERS = {
    "X = 3": "it is no class of a renderer, but of type int",
    "class X: pass": "it is no renderer: it has no render, memory, close",
    "def X(asset, **_): return 3": "it is no renderer: it has no name, version",
    "import sys; sys.exit()": "it cannot be loaded: SystemExit",
    "def (": "it cannot be loaded: SyntaxError",
}
WORKING = """
class X:
    name, version = "x", "1"
    def __init__(self, asset, *, device=None, settings=None): {made}
    def render(self, camera, background): {drawn}
    def memory(self): return {{}}
    def close(self): pass
"""
RENDERERS[WORKING.format(made="raise SystemExit", drawn="pass")] = "SystemExit"
RENDERERS[WORKING.format(made="pass", drawn="1 / 0")] = "ZeroDivisionError"
RENDERERS[WORKING.format(made="pass", drawn="return 3")] = "TypeError"
RENDERERS[WORKING.format(made="pass", drawn="return 3").replace("*, device", "*, devices")] = "TypeError"


@pytest.mark.parametrize(("text", "why"), RENDERERS.items())
def test_using_a_broken_renderer_names_its_package(
    package: Callable[..., Path], demo_asset: Path, text: str, why: str
) -> None:
    package("[msb.renderers]\nx = their_x:X\n", their_x=text)
    with pytest.raises(msb.MsbError, match=f"renderer x of package their_x: {why}") as caught:
        msb.render(demo_asset, CAMERA, name="x")
    assert (caught.value.code, caught.value.exit_status) == ("ENGINE_FAILED", 5)


@pytest.mark.parametrize("text", [*WAYS, "X = 3", "class X:\n    def missing(): raise SystemExit"])
def test_what_is_missing_of_a_broken_renderer_is_said(package: Callable[..., Path], text: str) -> None:
    package("[msb.renderers]\nx = their_x:X\ny =\n", their_x=text)
    assert what_is_missing("x")
    assert what_is_missing("y") == "its entry point names no module"


@pytest.mark.slow
def test_commands_keep_status_and_output(
    package: Callable[..., Path], msb_command: Msb, demo_asset: Path
) -> None:
    folder = package(
        "[msb.methods]\nx = their_x\ny = their_y\n",
        their_x="print('hello')\nimport sys; sys.exit()",
        their_y="raise KeyboardInterrupt",
    )
    where = {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    audit = msb_command("audit", "--json", "-", "--fail-on", "nonmanifold_edges>0", demo_asset, **where)
    assert audit.status == 1
    assert audit.json["schema"] == "msb.audit/1"
    lines = audit.err.replace("warning: ", "").splitlines()
    assert [line.partition(":")[0] for line in lines] == ["PACKAGE_LEFT_OUT"] * 2 + ["GATE_FAILED"]


@pytest.mark.slow
def test_devices_lists_all_beside_a_broken_renderer(package: Callable[..., Path], msb_command: Msb) -> None:
    folder = package("[msb.renderers]\nz = their_z:Z\n", their_z="import sys; sys.exit()")
    where = {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    devices = msb_command("devices", "--json", "-", **where)
    assert devices.status == 0
    (row,) = (row for row in devices.json["renderers"] if row["name"] == "z")
    assert row["missing"] == "it cannot be loaded: SystemExit"
