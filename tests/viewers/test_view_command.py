"""The commands `msb view` and `msb compare`: files, streams, exit status."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb.meshes import Mesh, write_mesh
from msb.scenes.datasets import read_scene
from msb_viewers.deployment.difference import scale_colors
from tests.cli.conftest import Here, here, refused
from tests.cli.forks import run_msb
from tests.conftest import BOOK
from tests.viewers.compare import CHECKPOINT, HEIGHT, WIDTH, photographs
from tests.viewers.conftest import HAS_PYVISTA, ROOT
from tests.viewers.test_compare_page import meta_of

__all__ = ["here", "refused"]
NO_DISPLAY = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}
_LIBRARIES = [
    f"lib{name}{version}"
    for name, versions in (("GL", ("", ".1")), ("EGL", ("", ".1")), ("OSMesa", ("", ".6", ".8")))
    for version in (f".so{number}" for number in versions)
]
needs_pyvista = pytest.mark.skipif(
    not HAS_PYVISTA, reason="pyvista is not installed; it belongs to the extra view"
)
linux = pytest.mark.skipif(sys.platform != "linux", reason="the test needs displays and libraries of Linux")


def view(*args: object, command: str = "view", **env: str) -> Any:
    done = run_msb([command, *map(str, args)], ROOT, {**NO_DISPLAY, **env})
    return subprocess.CompletedProcess(args, done.returncode, done.stdout.decode(), done.stderr.decode())


@pytest.fixture
def book(tmp_path: Path) -> Path:
    path = tmp_path / "book.ply"
    with path.open("wb") as file:
        write_mesh(Mesh(BOOK[0], BOOK[1].astype(np.int64), None, None), file, suffix=".ply")
    return path


def test_one_command_writes_image_figure_and_page(gl: None, book: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    files = [out / "a.png", out / "f.svg", out / "v.html"]
    result = view(
        "--screenshot", files[0], "--figure", files[1], "--html", files[2], "--size", "640x400", book
    )
    assert result.returncode == 0, result.stderr
    assert sorted(result.stdout.split()) == sorted(map(str, files))
    assert result.stderr == ""
    with Image.open(files[0]) as image:
        assert image.size == (640, 400)
    assert b"<svg" in files[1].read_bytes()[:500]
    assert b"book.ply" in files[2].read_bytes()
    again = view("--screenshot", files[0], book)
    assert again.returncode == 2
    assert "OUTPUT_EXISTS" in again.stderr


def test_the_image_shows_the_requested_element(gl: None, book: Path, tmp_path: Path) -> None:
    from msb_viewers.palette import HIGHLIGHT

    path = tmp_path / "at.png"
    result = view("--at", "nonmanifold_edges:1", "--show", "none", "--quiet", "--screenshot", path, book)
    assert result.returncode == 0, result.stderr
    assert result.stdout == ""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert (np.abs(pixels - HIGHLIGHT) <= 3).all(axis=2).sum() > 100


def test_audit_shows_the_mesh_that_it_audited(
    gl: None, here: Here, book: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr("msb_viewers.gl.check_display", lambda: None)
    monkeypatch.setattr("msb_viewers.commands.view.present", lambda *values: calls.append(values))
    assert here("audit", "--view", book).status == 0
    ((model, _, window, _),) = calls
    assert (model.name, model.audit.counts.nonmanifold_edges, window.written) == ("book.ply", 1, [])


@pytest.mark.slow
@needs_pyvista
@linux
@pytest.mark.parametrize(("command", "display"), [("view", ""), ("view", ":99"), ("audit --view", "")])
def test_a_window_without_a_display_is_rejected(command: str, display: str, book: Path) -> None:
    first, *rest = command.split()
    result = view(*rest, book, command=first, DISPLAY=display)
    assert result.returncode == 2
    assert result.stderr.startswith("VIEW_NO_DISPLAY: ")
    assert result.stderr.count("\n") == 1


@pytest.mark.slow
@needs_pyvista
@linux
def test_an_image_without_opengl_is_rejected(book: Path, tmp_path: Path) -> None:
    # Empty libraries hide those in the system folders.
    for name in _LIBRARIES:
        (tmp_path / name).write_bytes(b"")
    out = tmp_path / "x.png"
    result = view("--screenshot", out, book, LD_LIBRARY_PATH=str(tmp_path))
    assert result.returncode == 2
    assert result.stderr.startswith("VIEW_NO_DISPLAY: ")
    assert result.stderr.count("\n") == 1
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("view --html a.png", "USAGE"),
        ("view --size 10x10 --html a.html", "USAGE"),
        ("view --html a.html --at nonmanifold_edges:2", "NAME_UNKNOWN"),
        ("view --html a.html --vertex 5", "NAME_UNKNOWN"),
        ("view --html a.html --component 2", "NAME_UNKNOWN"),
        ("view --html a.html --show edges", "NAME_UNKNOWN"),
        ("view --html a.html --colors own", "NAME_UNKNOWN"),
        ("compare --camera 1 --html a.html", "USAGE"),
        ("compare --tiers best --html a.html", "NAME_UNKNOWN"),
        ("compare --pair standard --html a.html", "NAME_UNKNOWN"),
        ("compare --cameras none.json --html a.html", "FILE_NOT_FOUND"),
    ],
)
def test_wrong_use_is_one_line(
    here: Here, book: Path, line: str, code: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    result = here(*line.split(), book if line.startswith("view") else CHECKPOINT)
    assert (result.status, result.err.count("\n")) == (3 if code == "FILE_NOT_FOUND" else 2, 1)
    assert result.err.startswith(f"{code}: ")
    assert not list(tmp_path.glob("a.*"))


VIEWS = ROOT / "data_stubs" / "views.json"
FAST = ("--tiers", "dedicated,standard")
SCENE = ROOT / "data_stubs" / "scenes" / "mipnerf360" / "pebble"


def compare(*args: object, **env: str) -> Any:
    return view(*args, command="compare", **env)


@pytest.mark.slow
def test_comparisons_need_neither_vtk_nor_a_display(tmp_path: Path, no_pyvista: dict[str, str]) -> None:
    picture, page = tmp_path / "a" / "c.png", tmp_path / "a" / "c.html"
    result = compare(
        *FAST, "--cameras", VIEWS, "--camera", "2", "--camera", "turntable_00005",
        "--scale", "0.1", "--layout", "difference", "--screenshot", picture, "--html", page,
        "--size", "640x400", CHECKPOINT, **no_pyvista,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == [str(page), str(picture)]
    with Image.open(picture) as image:
        assert image.size == (640, 400)
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    assert (
        np.abs(pixels - scale_colors()[0]).max(axis=1) <= 1
    ).sum() > 10_000  # most pixels of the map show no difference
    meta = meta_of(page.read_text())
    assert [view["name"] for view in meta["views"]] == ["turntable_00002", "turntable_00005"]
    assert (meta["views"][0]["width"], meta["layout"]) == (64, "difference")
    assert all(20 < view["decibels"]["dedicated standard"] < 100 for view in meta["views"])


@pytest.mark.slow
def test_views_have_the_size_of_their_photographs_and_psnrs(tmp_path: Path) -> None:
    views = photographs(tmp_path / "images", [(250, 250, 250), (0, 0, 0)])
    out = tmp_path / "c.html"
    result = compare(
        "--cameras", VIEWS, "--images", tmp_path / "images", "--camera", "0", "--camera", "1",
        "--tiers", "standard,truth", "--background", "black", "--supersample", "2", "--html", out, "-q",
        CHECKPOINT,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout == result.stderr == ""
    meta = meta_of(out.read_text())
    assert [tier["tier"] for tier in meta["tiers"]] == ["truth", "standard"]
    assert meta["pair"] == ["truth", "standard"]
    assert {"standard tier 2 x 2 samples", "background black"} <= set(meta["settings"].split(", "))
    for stored, expected in zip(meta["views"], views, strict=True):
        assert (stored["width"], stored["height"]) == (WIDTH, HEIGHT)
        assert stored["name"] == expected.name
    white, black = (stored["decibels"]["standard truth"] for stored in meta["views"])
    assert white < 6 < black  # on a black background, the dark asset is more similar to the black photograph


@pytest.mark.parametrize(("scale", "factor"), [((), 1), (("--scale", "0.25"), 0.25)])
@pytest.mark.slow
def test_a_scene_gives_its_test_views_as_a_run_evaluates_them(
    tmp_path: Path, scale: tuple[str, ...], factor: float
) -> None:
    scene, out = read_scene(SCENE), tmp_path / "c.html"
    model = ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting"
    run = compare("--scene", SCENE, *scale, "--tiers", "standard,truth", "--html", out, model)
    assert run.returncode == 0, run.stderr
    meta = meta_of(out.read_text())
    assert [view["name"] for view in meta["views"]] == [camera.name for camera in scene.test]
    assert {view["width"] for view in meta["views"]} == {scene.test[0].width * factor}
    assert all("standard truth" in view["decibels"] for view in meta["views"])
    assert compare("--scene", SCENE, "--cameras", VIEWS, "--html", out, model).returncode == 2


@pytest.mark.parametrize("more", [(), ("--image-folder", "images_8"), ("--image-folder", SCENE / "images_8")])
def test_photographs_of_a_scene_are_found_as_render_finds_them(more: tuple[Any, ...], tmp_path: Path) -> None:
    out = tmp_path / "c.html"
    run = compare(
        *("--cameras", SCENE, "--camera", "0", "--tiers", "standard,truth", "--html", out, *more),
        ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting",
    )
    assert run.returncode == 0, run.stderr
    meta = meta_of(out.read_text())
    assert [tier["tier"] for tier in meta["tiers"]] == ["truth", "standard"]
    assert meta["views"][0]["width"] == (120 if more else 240)
    assert meta["views"][0]["decibels"]["standard truth"] > 10
