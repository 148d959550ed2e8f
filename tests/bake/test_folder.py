"""`msb bake -o FOLDER`: its files and its page, and what the report of a bake says."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import msb
from msb.bake.report import Psnr, Report, Verdict, mean
from msb.errors import UsageError
from msb.meshes import read_mesh
from msb.scenes import write_cameras
from tests.bake.conftest import line_of
from tests.bake.soups import ring
from tests.cli.conftest import Here

NAMES = {"asset.glb", "bake.json", "index.html", "preview.png"}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"msb-files.json"}


def scene_of(folder: Path) -> Any:
    """Return the data of a folder's page."""
    text = (folder / "index.html").read_text("utf-8")
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text)
    return json.loads(found[1])["baked"]


@pytest.mark.slow
def test_a_folder_has_all_that_was_made(here: Here, model: Path) -> None:
    out = model.parent / "out"
    result = here(*line_of(model, "--lods", "0.5", "--collision", "box", "--json", "-", out="out/"))
    assert result.status == 0, result
    assert names(out) == NAMES | {"asset_lod1.glb", "asset_collision.glb"}
    document, data = json.loads((out / "bake.json").read_text()), result.json
    # In the folder, which may be moved, files are called by their names alone.
    outputs = [[each["output"], each["lods"][0]["output"]] for each in (document, data)]
    assert outputs[0] == ["asset.glb", "asset_lod1.glb"]
    assert outputs[1] == [str(out / name) for name in outputs[0]]
    same = {"schema", "tool_version", "psnr", "sentence", "seconds", "bytes"}
    assert {key: document[key] for key in same} == {key: data[key] for key in same}
    assert data["bytes"] == (out / "asset.glb").stat().st_size
    assert len(read_mesh(out / "asset_collision.glb").faces) == 12
    with Image.open(out / "preview.png") as picture:
        # Native rendering, plain mesh and bake, in two views.
        assert picture.size == (3 * ring(1)[0].width, 2 * ring(1)[0].height)
        assert picture.getbbox() is not None
    own = [data["psnr"]["own"][name] for name in ("before", "after", "after_16")]
    assert [row[1] for row in scene_of(out)["losses"][1:]] == [f"{value:.1f}" for value in own]
    assert [term for term, _ in scene_of(out)["facts"]] == [
        *("asset.glb", "asset_lod1.glb", "asset_collision.glb", "Before", "Now")
    ]


@pytest.mark.slow
def test_only_files_of_an_earlier_bake_are_replaced(here: Here, model: Path) -> None:
    out = model.parent / "out"
    out.mkdir()
    assert here(*line_of(model, "-q", "--collision", "box", out="out")).status == 0
    here(*line_of(model, out="out")).ends(2, "OUTPUT_EXISTS: ")
    (out / "notes.txt").write_text("mine")
    assert here(*line_of(model, "-f", out="out")).status == 0
    assert names(out) == NAMES | {"notes.txt"}
    assert (out / "notes.txt").read_text() == "mine"


def test_an_invalid_place_for_a_folder_is_rejected(here: Here, model: Path) -> None:
    page = model.parent / "site" / "index.html"
    page.parent.mkdir()
    page.write_text("not ours")
    (model.parent / "plain").write_text("a file")
    before = sorted(model.parent.rglob("*"))
    here(*line_of(model, "-f", out="site")).ends(2, "OUTPUT_EXISTS: ")
    here(*line_of(model, "-f", out="plain")).ends(2, "OUTPUT_EXISTS: ")
    here(*line_of(model, "-o", model.parent / "new")).ends(2, f"USAGE: {model.parent / 'new'}: ")
    here(*line_of(model, out="plain/below")).ends(3, "OUTPUT_UNWRITABLE: ")
    assert sorted(model.parent.rglob("*")) == before


def test_python_writes_the_same_folder(model: Path) -> None:
    pytest.importorskip("msb.engines", reason="the page needs msb.engines")
    write_cameras(ring(1), model.parent / "cameras.json")
    cameras = msb.read_cameras(model.parent / "cameras.json")
    baked = msb.bake(model, cameras=cameras, geometry="kept")
    out = model.parent / "out"
    assert baked.save(out).output == str(out / "asset.glb")
    assert names(out) == NAMES
    assert len(baked.preview.columns) == 3
    # The only view supervised, so there are images and no numbers.
    assert scene_of(out)["losses"] == []
    for places, code in (((out,), "OUTPUT_EXISTS"), ((model.parent / "b", model.parent / "a.glb"), "USAGE")):
        with pytest.raises(UsageError) as caught:
            baked.save(*places)
        assert caught.value.code == code


@pytest.mark.slow
def test_the_page_shows_each_file(here: Here, model: Path, in_browser: Callable[..., Any]) -> None:
    assert here(*line_of(model, "-q", "--collision", "box", out="out")).status == 0
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
    page = (model.parent / "out" / "index.html").read_bytes()
    first, second, listed, losses, kinds, picture, message = in_browser(page, script)
    assert (first[:2], second[:2]) == (["asset.glb", "4 faces"], ["asset_collision.glb", "12 faces"])
    assert first[2] != second[2]
    assert listed == ["asset.glb", "asset_collision.glb"]
    assert losses.startswith("dB")
    assert (kinds, picture, message) == (["baked", "baked"], True, "")


SOUP = Verdict("bad", "renders; not usable for booleans", "triangle soup")
REPORT = Report(
    geometry="fitted",
    color="texture",
    vertices=4881,
    faces=1627,
    texture=(512, 512),
    seconds=46.9,
    taught=49,
    between=0,
    held_back=7,
    views="49 training views of pebble",
    teacher="dedicated",
    unseen_area=0.02,
    own=Psnr(None, 18.18, 33.34, 34.05),
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


def test_what_a_file_carries_does_not_depend_on_where_and_how_fast_it_was_made() -> None:
    other = replace(REPORT, path="/home/me/model", output="b.glb", seconds=3.0, bytes=1, device="gpu")
    assert other.extras() == REPORT.extras()
    assert "home" not in json.dumps(other.extras())


def test_equal_images_count_as_the_cap_of_the_metric() -> None:
    assert mean([float("inf"), 50.0]) == 75.0


def test_a_bake_may_be_worse_than_the_plain_mesh() -> None:
    assert Psnr(None, 20.2, 15.3, 15.6).is_worse
    assert not Psnr(None, 20.2, 19.0, 21.0).is_worse
    assert not Psnr(None, None, 15.3, 15.6).is_worse


def test_the_json_has_the_keys_that_others_rely_on() -> None:
    data = REPORT.to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["schema"] == "msb.bake/1"
    assert data["texture"] == [512, 512]
    assert {"taught", "between", "held_back"} <= data["views"].keys()
    assert data["psnr"]["own"] == {"before": 18.18, "after": 33.34, "after_16": 34.05}
    assert data["psnr"]["photographs"].keys() == {"dedicated", "before", "after", "after_16"}
    assert data["verdict_after"] == {"level": "bad", "sentence": SOUP.sentence}
    paths = {"path", "output", "bytes", "lods", "collision"}
    assert {"geometry", "color", "vertices", "faces", "seconds", "unseen_area", *paths} <= data.keys()
    alone = replace(REPORT, photographs=None, own=None, held_back=0).to_dict()
    assert alone["psnr"] == {"own": None, "photographs": None}
