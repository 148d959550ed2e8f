"""The sentence and the JSON of a bake say the same, and the sentence fits a line."""

from __future__ import annotations

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


def test_the_sentence_has_the_numbers_to_photographs_where_there_are_any() -> None:
    assert REPORT.sentence == (
        "own look 36.1 dB, plain mesh before 18.1, baked 32.2 (32.8 with 16 samples), on 7 views it never "
        "used; 1,627 triangles, texture 512, 0.47 MB, 47 s; BAD as before: triangle soup: --geometry surface "
        "for solids"
    )


def test_without_photographs_it_is_compared_with_its_own_look() -> None:
    said = replace(REPORT, photographs=None, color="vertex", texture=None, bytes=None).sentence
    assert said == (
        "plain mesh before 18.2 dB, baked 33.3 (34.0 with 16 samples) to its own look, on 7 views it never "
        "used; 1,627 triangles, 47 s; BAD as before: triangle soup: --geometry surface for solids"
    )
    tried = replace(REPORT, tried={"surface": 30.42, "fitted": 29.9}).sentence
    assert tried.endswith(
        "; surface 30.4 dB, fitted 29.9 dB by views kept aside; 1,627 triangles, texture 512, 0.47 MB, 47 s; "
        "BAD as before: triangle soup"
    ), "where a surface was tried it is no way out"
    neural = replace(REPORT, photographs=None, own=Psnr(None, None, 30.0, 31.0), held_back=1)
    assert neural.loss == "baked 30.0 dB (31.0 with 16 samples) to its own look, on 1 view it never used"


def test_one_view_states_nothing() -> None:
    alone = replace(REPORT, photographs=None, own=None, held_back=0, faces=1, after=Verdict("ok", "good", ""))
    assert alone.sentence == (
        "no dB, as no view is held back: that takes two or more; 1 triangle, texture 512, 0.47 MB, 47 s; "
        "OK, was BAD"
    )
    assert alone.to_dict()["psnr"] == {"own": None, "photographs": None}


def test_the_json_has_the_keys_that_others_rely_on() -> None:
    data = REPORT.to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["schema"] == "msb.bake/1"
    assert data["texture"] == [512, 512]
    assert {"taught", "between", "held_back"} <= data["views"].keys()
    assert data["psnr"]["own"] == {"before": 18.18, "after": 33.34, "after_16": 34.05}
    assert data["psnr"]["photographs"].keys() == {"dedicated", "before", "after", "after_16"}
    assert data["verdict_after"] == {"level": "bad", "sentence": SOUP.sentence}
    for key in ("path", "output", "geometry", "color", "vertices", "faces", "bytes", "seconds"):
        assert key in data
    for key in ("unseen_area", "verdict_before", "lods", "collision"):
        assert key in data


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
