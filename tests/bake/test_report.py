"""The sentence and the JSON of a bake say the same, and the sentence fits a line."""

import json
from dataclasses import replace

from msb.bake.report import Psnr, Report, Verdict, mean

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
