"""`msb bake -o FOLDER`: what lies in it, what its page shows, and what is never replaced."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import msb
from msb.errors import UsageError
from msb.meshes import read_mesh
from msb.scenes import write_cameras
from tests.bake.test_views import ring
from tests.cli.conftest import Here
from tests.cli.test_bake import solid

NAMES = ["asset.glb", "asset_collision.glb", "asset_lod1.glb", "bake.json", "index.html", "preview.png"]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def line(tmp_path: Path) -> list[Any]:
    """Return a quick bake of a plain mesh, without its output."""
    solid().save(tmp_path / "solid.triasset")
    write_cameras(ring(9), tmp_path / "cameras.json")
    return ["bake", "--geometry", "kept", "--cameras", tmp_path / "cameras.json", tmp_path / "solid.triasset"]


def scene_of(folder: Path) -> Any:
    """Return what the page of a folder is told."""
    text = (folder / "index.html").read_text("utf-8")
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text)
    assert found is not None
    return json.loads(found[1])


@pytest.mark.slow
def test_a_folder_has_all_that_was_made(here: Here, line: list[Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = here(*line, "--lods", "0.5", "--collision", "box", "--json", "-", "-o", f"{out}/")
    assert result.status == 0, result
    assert names(out) == NAMES
    document, data = json.loads((out / "bake.json").read_text()), result.json
    # There files have their names in the folder, which may be moved.
    assert (data["output"], document["output"]) == (str(out / "asset.glb"), "asset.glb")
    assert (data["lods"][0]["output"], document["lods"][0]["output"]) == (
        str(out / "asset_lod1.glb"),
        "asset_lod1.glb",
    )
    assert data["collision"]["output"] == str(out / "asset_collision.glb")
    assert {key: document[key] for key in ("schema", "tool_version", "psnr", "sentence", "seconds")} == {
        key: data[key] for key in ("schema", "tool_version", "psnr", "sentence", "seconds")
    }
    assert data["bytes"] == document["bytes"] == (out / "asset.glb").stat().st_size
    assert len(read_mesh(out / "asset_collision.glb").faces) == 12
    with Image.open(out / "preview.png") as picture:
        width, height = ring(1)[0].width, ring(1)[0].height
        assert picture.size == (3 * width, 2 * height), "look, plain, baked; in two views"
        assert picture.getbbox() is not None
    told = scene_of(out)["baked"]
    own = data["psnr"]["own"]
    assert told["losses"] == [
        ["dB", "to its own look"],
        ["plain mesh before", f"{own['before']:.1f}"],
        ["baked", f"{own['after']:.1f}"],
        ["baked, 16 samples", f"{own['after_16']:.1f}"],
    ]
    assert [term for term, _ in told["facts"]] == [
        *("asset.glb", "asset_lod1.glb", "asset_collision.glb", "Before", "Now")
    ]


@pytest.mark.slow
def test_only_what_a_bake_wrote_is_replaced(here: Here, line: list[Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    assert here(*line, "-q", "--collision", "box", "-o", out).status == 0, "an empty folder is none"
    here(*line, "-o", out).ends(2, f"OUTPUT_EXISTS: {out}: it exists; --force replaces it")
    assert here(*line, "-f", "-o", out).status == 0
    assert names(out) == ["asset.glb", "bake.json", "index.html", "preview.png"]
    (out / "notes.txt").write_text("mine")
    here(*line, "-f", "-o", out).ends(2, f"OUTPUT_EXISTS: {out}: it holds notes.txt, which no bake wrote")
    assert (out / "notes.txt").read_text() == "mine"


def test_what_is_no_place_for_a_folder_is_one_line(here: Here, line: list[Any], tmp_path: Path) -> None:
    page = tmp_path / "site" / "index.html"
    page.parent.mkdir()
    page.write_text("somebody's")
    plain = tmp_path / "plain"
    plain.write_text("a file")
    before = sorted(tmp_path.rglob("*"))
    said = "which no bake wrote and which would be lost; give another folder"
    here(*line, "-f", "-o", page.parent).ends(2, f"OUTPUT_EXISTS: {page.parent}: it holds index.html, {said}")
    here(*line, "-f", "-o", plain).ends(2, f"OUTPUT_EXISTS: {plain}: it is a file; give a folder")
    here(*line, "-f", "-o", tmp_path).ends(2, f"USAGE: {tmp_path}: ASSET lies in it")
    here(*line, "-o", tmp_path / "a.glb", "-o", tmp_path / "new").ends(
        2, f"USAGE: {tmp_path / 'new'}: it is written as a folder, which is the only output"
    )
    here(*line, "-o", plain / "below").ends(3, f"OUTPUT_UNWRITABLE: {plain / 'below'}: ")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_folder_is_whole_or_as_it_was(
    here: Here, line: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def die(*_: object) -> None:
        raise error

    out = tmp_path / "out"
    assert here(*line, "-q", "--collision", "box", "-o", out).status == 0
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setattr("msb.bake.folder._page", die)
    for place in (out, tmp_path / "new"):
        result = here(*line, "-f", "-o", place)
        if isinstance(error, OSError):
            result.ends(3, f"OUTPUT_UNWRITABLE: {place}: it cannot be written: No space left on device")
        else:
            assert result.status == 130
    assert sorted(tmp_path.rglob("*")) == before


def test_python_writes_the_same_folder(line: list[Any], tmp_path: Path) -> None:
    write_cameras(ring(1), tmp_path / "cameras.json")
    cameras = msb.read_cameras(tmp_path / "cameras.json")
    baked = msb.bake(tmp_path / "solid.triasset", cameras=cameras, geometry="kept")
    report = baked.save(tmp_path / "out")
    assert report.output == str(tmp_path / "out" / "asset.glb")
    assert baked.preview.columns == ("own look", "plain mesh before", "baked")
    told = scene_of(tmp_path / "out")["baked"]
    # The only view taught, so that there is no number, but a picture.
    assert told["losses"] == []
    assert told["caption"].endswith("in views that taught it, for lack of others.")
    with pytest.raises(UsageError, match="overwrite=True replaces it"):
        baked.save(tmp_path / "out")
    with pytest.raises(UsageError, match="the only output"):
        baked.save(tmp_path / "other", tmp_path / "a.glb")


@pytest.mark.slow
def test_the_page_shows_each_file(
    here: Here, line: list[Any], tmp_path: Path, in_browser: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    assert here(*line, "-q", "--collision", "box", "-o", out).status == 0
    script = """
        await ready;
        const shown = () => [byId("name").textContent, byId("facts").textContent, canvas.toDataURL()];
        showNow();
        const first = shown(), select = byId("file-shown");
        select.value = "asset_collision.glb";
        select.dispatchEvent(new Event("change"));
        for (let i = 0; i < 500 && byId("facts").textContent === first[1]; i += 1)
          await new Promise((done) => setTimeout(done, 20));
        showNow();
        const kinds = [...document.querySelectorAll("[data-for]")].filter((part) => !part.hidden);
        return [first, shown(), [...select.options].map((option) => option.value), byId("losses").textContent,
          kinds.map((part) => part.dataset.for), byId("preview").naturalWidth > 0,
          byId("message").textContent];"""
    first, second, listed, losses, kinds, picture, message = in_browser(
        (out / "index.html").read_bytes(), script
    )
    assert first[:2] == ["asset.glb", "4 faces"]
    assert second[:2] == ["asset_collision.glb", "12 faces"]
    assert first[2] != second[2]
    assert listed == ["asset.glb", "asset_collision.glb"]
    assert losses.startswith("dBto its own lookplain mesh before")
    assert (kinds, picture, message) == (["baked", "baked"], True, "")
