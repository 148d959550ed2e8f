"""Plug-ins that exit, print or are invalid are ignored."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import msb
from msb.base.packages import PackageError, PackageWarning, contain_errors, find_installed, load
from msb.render.backend import BUILT_IN, ENGINES, renderers, why_unavailable

CAMERA = msb.Camera.look_at((0, 0, 3), (0, 0, 0), up=(0, 1, 0), width=8, height=6, fov_y=0.9)
Install = Callable[..., Path]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return a function that installs modules and an entry_points.txt."""
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
    "def (": "SyntaxError",
    "pass": "AttributeError",
}


@pytest.mark.parametrize(("text", "why"), WAYS.items())
def test_a_module_that_cannot_be_loaded_is_a_package_error(package: Install, text: str, why: str) -> None:
    package("", their_part=text)
    with pytest.raises(PackageError, match=why):
        load("their_part:Part")


def test_output_of_a_package_goes_to_standard_error(
    package: Install, capsys: pytest.CaptureFixture[str]
) -> None:
    package("", their_part="print('hello')\n")
    load("their_part")
    with contain_errors():
        print("later")
    assert capsys.readouterr() == ("", "hello\nlater\n")


def test_ctrl_c_passes() -> None:
    with pytest.raises(KeyboardInterrupt), contain_errors():
        raise KeyboardInterrupt


def test_the_first_of_two_plugins_with_the_same_name_is_used(package: Install) -> None:
    package("[msb.renderers]\nx = their_b:X\nx = their_a:X\nstandard = their_c:X\n")
    with pytest.warns(PackageWarning, match="PACKAGE_LEFT_OUT") as caught:
        assert renderers() == {**BUILT_IN, **ENGINES, "x": "their_a:X"}
    assert ["their_c" in str(one.message) for one in caught] == [True, False]
    assert "their_b" in str(caught[1].message)


def test_names_must_match_the_pattern_of_their_group(package: Install) -> None:
    package("[msb.commands]\nown-thing = their_a:x\nNo = their_a:x\n")
    with pytest.warns(PackageWarning, match="No"):
        commands = find_installed("command", {}, lambda name, _: name, pattern=r"^[a-z-]+$")
    assert commands == {"own-thing": ("own-thing", "their_a:x")}


def test_an_entry_point_file_that_cannot_be_read_hides_no_other(
    package: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package("[msb.renderers]\nno equals sign\n")
    other = tmp_path / "other" / "good-1.0.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Name: good\n")
    (other / "entry_points.txt").write_text("[msb.renderers]\nx = their_a:X\n")
    monkeypatch.syspath_prepend(other.parent)
    with pytest.warns(PackageWarning, match="theirs"):
        assert renderers() == {**BUILT_IN, **ENGINES, "x": "their_a:X"}


WORKING = """
class X:
    name, version = "x", "1"
    def __init__(self, asset, *, device=None, settings=None): {made}
    def render(self, camera, background): {drawn}
    def memory(self): return {{}}
    def close(self): pass
"""
RENDERERS = {
    "X = 3": "type int",
    "class X: pass": "render, memory, close",
    "def X(asset, **_): return 3": "name, version",
    WORKING.format(made="raise SystemExit", drawn="pass"): "SystemExit",
    WORKING.format(made="pass", drawn="1 / 0"): "ZeroDivisionError",
    WORKING.format(made="pass", drawn="return 3"): "TypeError",
}


@pytest.mark.parametrize(("text", "why"), RENDERERS.items())
def test_using_a_broken_renderer_names_its_package(
    package: Install, demo_asset: Path, text: str, why: str
) -> None:
    package("[msb.renderers]\nx = their_x:X\n", their_x=text)
    with pytest.raises(msb.MsbError, match=f"their_x: .*{why}") as caught:
        msb.render(demo_asset, CAMERA, name="x")
    assert (caught.value.code, caught.value.exit_status) == ("ENGINE_FAILED", 5)


@pytest.mark.parametrize("text", [*WAYS, "X = 3", "class X:\n    def missing(): raise SystemExit"])
def test_a_broken_renderer_has_a_reason(package: Install, text: str) -> None:
    package("[msb.renderers]\nx = their_x:X\ny =\n", their_x=text)
    assert why_unavailable("x")
    assert why_unavailable("y")
