"""`msb bake -o FOLDER`: its files and its page, and the report of a bake."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import msb
from msb.bake.report import (
    Psnr,
    Report,
    Verdict,
    average_psnr,
    list_coverage_notes,
    list_quality_notes,
)
from msb.bake.views import BakeViews
from msb.errors import UsageError
from msb.meshes import read_mesh
from msb.scenes import write_cameras
from tests.bake.conftest import bake_words
from tests.bake.soups import ring
from tests.cli.conftest import Here

NAMES = {"asset.glb", "bake.json", "index.html", "preview.png"}


def list_names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"msb-files.json"}


def page_data(folder: Path) -> Any:
    """Return the data in a folder's page."""
    text = (folder / "index.html").read_text("utf-8")
    match = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text)
    return json.loads(match[1])["baked"]


@pytest.mark.slow
def test_a_folder_has_all_files(here: Here, model: Path) -> None:
    out = model.parent / "out"
    result = here(*bake_words(model, "--lods", "0.5", "--collision", "box", "--json", "-", out="out/"))
    assert result.status == 0, result
    assert list_names(out) == NAMES | {"asset_lod1.glb", "asset_collision.glb"}
    document, data = json.loads((out / "bake.json").read_text()), result.json
    # Paths in the folder are relative, so that it can be moved.
    outputs = [[report["output"], report["lods"][0]["output"]] for report in (document, data)]
    assert outputs[0] == ["asset.glb", "asset_lod1.glb"]
    assert outputs[1] == [str(out / name) for name in outputs[0]]
    same = {"schema", "tool_version", "psnr", "sentence", "seconds", "bytes"}
    assert {key: document[key] for key in same} == {key: data[key] for key in same}
    assert data["bytes"] == (out / "asset.glb").stat().st_size
    assert len(read_mesh(out / "asset_collision.glb").faces) == 12
    with Image.open(out / "preview.png") as picture:
        # Native rendering, unbaked mesh and baked mesh, in two views.
        assert picture.size == (3 * ring(1)[0].width, 2 * ring(1)[0].height)
        assert picture.getbbox() is not None
    native = [data["psnr"]["native"][name] for name in ("before", "after", "after_16", "model_only_16")]
    assert [row[1] for row in page_data(out)["losses"][1:]] == [f"{value:.1f}" for value in native]
    assert [term for term, _ in page_data(out)["facts"]] == [
        *("asset.glb", "asset_lod1.glb", "asset_collision.glb", "Before", "Now")
    ]


@pytest.mark.slow
def test_only_files_of_an_earlier_bake_are_replaced(here: Here, model: Path) -> None:
    out = model.parent / "out"
    out.mkdir()
    assert here(*bake_words(model, "-q", "--collision", "box", out="out")).status == 0
    here(*bake_words(model, out="out")).ends(2, "OUTPUT_EXISTS: ")
    (out / "notes.txt").write_text("mine")
    assert here(*bake_words(model, "-f", out="out")).status == 0
    assert list_names(out) == NAMES | {"notes.txt"}
    assert (out / "notes.txt").read_text() == "mine"


def test_invalid_places_for_a_folder_are_rejected(here: Here, model: Path) -> None:
    page = model.parent / "site" / "index.html"
    page.parent.mkdir()
    page.write_text("not ours")
    (model.parent / "plain").write_text("a file")
    before = sorted(model.parent.rglob("*"))
    here(*bake_words(model, "-f", out="site")).ends(2, "OUTPUT_EXISTS: ")
    here(*bake_words(model, "-f", out="plain")).ends(2, "OUTPUT_EXISTS: ")
    here(*bake_words(model, "-o", model.parent / "new")).ends(2, f"USAGE: {model.parent / 'new'}: ")
    here(*bake_words(model, out="plain/below")).ends(3, "OUTPUT_UNWRITABLE: ")
    assert sorted(model.parent.rglob("*")) == before


def test_python_writes_the_same_folder(model: Path) -> None:
    pytest.importorskip("msb.engines", reason="the page needs msb.engines")
    write_cameras(ring(1), model.parent / "cameras.json")
    cameras = msb.read_cameras(model.parent / "cameras.json")
    baked = msb.bake(model, cameras=cameras, geometry="kept")
    out = model.parent / "out"
    assert baked.save(out).output == str(out / "asset.glb")
    assert list_names(out) == NAMES
    assert len(baked.preview.columns) == 3
    # The only view is a training view, so the page has a preview image but no PSNR.
    assert page_data(out)["losses"] == []
    for places, code in (((out,), "OUTPUT_EXISTS"), ((model.parent / "b", model.parent / "a.glb"), "USAGE")):
        with pytest.raises(UsageError) as caught:
            baked.save(*places)
        assert caught.value.code == code


@pytest.mark.slow
def test_the_page_shows_each_file(here: Here, model: Path, in_browser: Callable[..., Any]) -> None:
    assert here(*bake_words(model, "-q", "--collision", "box", out="out")).status == 0
    script = """
        await ready;
        const readPage = () => [byId("name").textContent, byId("facts").textContent, canvas.toDataURL()];
        showNow();
        const first = readPage(), select = byId("file-shown");
        select.value = "asset_collision.glb";
        select.dispatchEvent(new Event("change"));
        for (let i = 0; i < 500 && byId("facts").textContent === first[1]; i += 1)
          await new Promise((done) => setTimeout(done, 20));
        showNow();
        const kinds = [...document.querySelectorAll("[data-for]")].filter((part) => !part.hidden);
        return [first, readPage(), [...select.options].map((option) => option.value),
          byId("losses").textContent, kinds.map((part) => part.dataset.for), byId("preview").naturalWidth > 0,
          byId("message").textContent];"""
    page = (model.parent / "out" / "index.html").read_bytes()
    first, second, listed, losses, kinds, picture, message = in_browser(page, script)
    assert (first[:2], second[:2]) == (["asset.glb", "4 faces"], ["asset_collision.glb", "12 faces"])
    assert first[2] != second[2]
    assert listed == ["asset.glb", "asset_collision.glb"]
    assert losses.startswith("PSNR in dB")
    assert (kinds, picture, message) == (["baked", "baked"], True, "")


SOUP = Verdict("bad", "renders; not usable for booleans", "triangle soup")
REPORT = Report(
    geometry="fitted",
    color="texture",
    vertices=4881,
    faces=1627,
    texture=(512, 512),
    seconds=46.9,
    training=42,
    validation=7,
    test=7,
    interpolated=0,
    views="49 training views of pebble",
    supervision="native",
    unseen_area=0.02,
    native=Psnr(None, 18.18, 33.34, 34.05),
    photographs=Psnr(36.06, 18.13, 32.16, 32.77),
    before=SOUP,
    after=SOUP,
    model_faces=2499,
    background=(0.0, 0.0, 0.0),
    seed=0,
    device="cpu",
    tried={"kept": 28.0, "fitted": 34.0},
    bytes=467_000,
)


def test_extras_of_a_file_contain_no_paths_and_times() -> None:
    other = replace(REPORT, path="/home/me/model", output="b.glb", seconds=3.0, bytes=1, device="gpu")
    assert other.extras() == REPORT.extras()
    assert "home" not in json.dumps(other.extras())


def test_psnr_of_equal_images_is_capped_in_averages() -> None:
    assert average_psnr([float("inf"), 50.0]) == 75.0


def test_a_bake_can_be_worse_than_the_unbaked_mesh() -> None:
    assert Psnr(None, 20.2, 15.3, 15.6).is_worse
    assert not Psnr(None, 20.2, 19.0, 21.0).is_worse
    assert not Psnr(None, None, 15.3, 15.6).is_worse


def test_a_bake_is_compared_with_its_training_images() -> None:
    worse, better = Psnr(None, 20.2, 15.3, 15.6), Psnr(None, 20.2, 19.0, 21.0)
    for supervision in ("native", "photographs"):
        is_native = supervision == "native"
        for native, photographs in ((worse, better), (better, worse), (worse, None), (None, None)):
            reference = native if is_native else photographs
            notes = list_quality_notes(supervision, native, photographs)
            assert len(notes) == (reference is worse)
            assert all(("native rendering" in note) == is_native for note in notes)


@pytest.mark.parametrize(("origin", "kind"), [("turntable", "inside"), ("inside", "outside"), ("both", None)])
def test_generated_views_that_see_little_are_noted(origin: str, kind: str | None) -> None:
    views = BakeViews((), (), (), (), origin, "", (0, 0, 0), is_generated=True)
    (note,) = list_coverage_notes(views, 0.634)
    assert "37 %" in note
    assert ("--views" in note) == (kind is not None)
    assert kind is None or f"or {kind}" in note
    assert list_coverage_notes(views, 0.2) == []
    assert list_coverage_notes(replace(views, is_generated=False), 0.634) == []


def test_keys_of_the_json() -> None:
    data = REPORT.to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["schema"] == "msb.bake/1"
    assert data["texture"] == [512, 512]
    views = {"training": 42, "validation": 7, "test": 7, "interpolated": 0}
    assert data["views"] == {**views, "from": "49 training views of pebble"}
    values = {"before": 18.18, "after": 33.34, "after_16": 34.05, "model_only_16": None}
    assert data["psnr"]["native"] == values
    assert data["psnr"]["photographs"].keys() == {"native", "before", "after", "after_16"}
    assert data["supervision"] == "native"
    assert data["verdict_after"] == {"level": "bad", "sentence": SOUP.sentence}
    paths = {"path", "output", "bytes", "lods", "collision"}
    assert {"geometry", "color", "vertices", "faces", "seconds", "unseen_area", *paths} <= data.keys()
    unmeasured = replace(REPORT, photographs=None, native=None, test=0).to_dict()
    assert unmeasured["psnr"] == {"native": None, "photographs": None}
