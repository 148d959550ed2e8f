"""`msb compare` from outside: files, streams, exit status; nothing here needs GL."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb_viewers.deployment.difference import scale_colors
from tests.viewers.compare import CHECKPOINT, HEIGHT, WIDTH, photographs
from tests.viewers.conftest import ROOT
from tests.viewers.test_compare_page import meta_of
from tests.viewers.test_view_command import view

VIEWS = ROOT / "data_stubs" / "views.json"
FAST = ("--tiers", "dedicated,standard")
SCENE = ROOT / "data_stubs" / "scenes" / "mipnerf360" / "pebble"


def compare(*args: object, **env: str) -> Any:
    return view(*args, command="compare", **env)


@pytest.mark.slow
def test_pictures_and_pages_need_neither_vtk_nor_a_display(
    tmp_path: Path, no_pyvista: dict[str, str]
) -> None:
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
    assert (np.abs(pixels - scale_colors()[0]).max(axis=1) <= 1).sum() > 10_000  # most of the map
    meta = meta_of(page.read_text())
    assert [view["name"] for view in meta["views"]] == ["turntable_00002", "turntable_00005"]
    assert (meta["views"][0]["width"], meta["layout"]) == (64, "difference")
    assert all(20 < view["decibels"]["dedicated standard"] < 100 for view in meta["views"])


@pytest.mark.slow
def test_photographs_are_the_truth_and_views_have_their_size(tmp_path: Path) -> None:
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
    for stored, made in zip(meta["views"], views, strict=True):
        assert (stored["width"], stored["height"]) == (WIDTH, HEIGHT)
        assert stored["name"] == made.name
    white, black = (stored["decibels"]["standard truth"] for stored in meta["views"])
    assert white < 6 < black  # a dark asset on black is far from white


def test_a_file_to_write_is_required() -> None:
    result = compare(CHECKPOINT)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("USAGE: ")


@pytest.mark.parametrize("more", [(), ("--image-folder", "images_8"), ("--image-folder", SCENE / "images_8")])
def test_photographs_of_a_scene_are_found_as_render_finds_them(more: tuple[Any, ...], tmp_path: Path) -> None:
    out = tmp_path / "c.html"
    shown = compare(
        *("--cameras", SCENE, "--camera", "0", "--tiers", "standard,truth", "--html", out, *more),
        ROOT / "data_stubs" / "models" / "walled" / "triangle_splatting",
    )
    assert shown.returncode == 0, shown.stderr
    meta = meta_of(out.read_text())
    assert [tier["tier"] for tier in meta["tiers"]] == ["truth", "standard"]
    assert meta["views"][0]["width"] == (120 if more else 240)
    assert meta["views"][0]["decibels"]["standard truth"] > 10
