"""Commands take the views that matter, say which, and judge nothing by pictures that show nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from msb.scenes import write_cameras
from tests.cli.conftest import Here, Msb
from tests.conftest import ROOT
from tests.test_views import CAPTURE, MODELS, elsewhere


@pytest.mark.slow
@pytest.mark.parametrize("command", ["trial --task decimate_50", "why", "repair --compare --task none"])
def test_commands_say_which_views_judge_and_where_none_sees_it(
    msb: Msb, tmp_path: Path, command: str
) -> None:
    away = tmp_path / "away.json"
    write_cameras(elsewhere(), away)
    model = MODELS / "walled" / "triangle_splatting"
    out = ("-o", tmp_path / "out") if "repair" in command else ()
    result = msb(*command.split(), *out, "--cameras", away, model, status=0)
    assert "no camera sees the mesh" in result.out + result.err
    assert "dB" not in result.out.replace("Cause", "").splitlines()[-1]


@pytest.mark.slow
def test_the_cameras_of_the_training_judge_trial_and_why(msb: Msb) -> None:
    said = "12 of 57 cameras of the training (pebble)"
    result = msb("trial", "--task", "decimate_50", "--json", "-", CAPTURE)
    assert result.json["cameras"] == {"count": 12, "from": "training", "views": said}
    numbers = result.json["trials"][0]["numbers"]["fast_simplification"]
    assert numbers["psnr"] == pytest.approx(26.4, abs=0.3)
    assert f"views: {said}" in msb("trial", "--task", "solid", CAPTURE).out


def test_an_empty_picture_is_a_warning(msb: Msb, tmp_path: Path) -> None:
    write_cameras(elsewhere(), tmp_path / "away.json")
    where = ("--cameras", tmp_path / "away.json", "-o", tmp_path / "out", MODELS / "pebble" / "two_dts")
    assert "warning: no picture shows any of it" in msb("render", *where).err


def test_renderings_of_one_colour_have_no_numbers(msb: Msb, tmp_path: Path) -> None:
    photographs = ROOT / "data_stubs/scenes/tanksandtemples/pebble/images"
    for folder in ("empty", "true"):
        (tmp_path / folder).mkdir()
    for path in sorted(photographs.iterdir())[:2]:
        with Image.open(path) as image:
            image.save(tmp_path / "true" / f"{path.stem}.png")
            Image.new("RGB", image.size, "white").save(tmp_path / "empty" / f"{path.stem}.png")
    found = msb("eval", "--json", "-", tmp_path / "empty", tmp_path / "true").json
    assert set(found["mean"].values()) == {None}
    assert found["images"][0]["psnr"] is None
    assert found["reason"].startswith("every rendering is of one colour")
    assert found["reason"] in msb("eval", tmp_path / "empty", tmp_path / "true").err


@pytest.mark.parametrize("tier", ["standard", pytest.param("dedicated", marks=pytest.mark.slow)])
def test_a_page_has_the_cameras_of_the_training(msb: Msb, tmp_path: Path, tier: str) -> None:
    page = tmp_path / "page.html"
    result = msb("web -o", page, "--tier", tier, *(["--no-verify"] if tier == "dedicated" else []), CAPTURE)
    assert "note: views: 12 of 57 cameras of the training (pebble)" in result.err
    assert page.read_text("utf-8").count('"world_to_camera"') >= 12


@pytest.mark.parametrize(
    "command",
    [
        "trial --task uv data_stubs/splat_like.triasset",
        "repair data_stubs/checkpoint NEW.ply",
        "repair --compare --task none data_stubs/checkpoint",
        "render --turntable 1 -o NEW data_stubs/checkpoint",
    ],
)
@pytest.mark.parametrize(
    ("device", "status", "code"),
    [("foo", 5, "DEVICE_NOT_FOUND"), ("nan", 5, "DEVICE_NOT_FOUND"), (":", 2, "DEVICE_SELECTOR")],
)
def test_a_device_that_is_not_there_is_refused(
    here: Here, tmp_path: Path, command: str, device: str, status: int, code: str
) -> None:
    result = here(*command.replace("NEW", str(tmp_path / "new")).split(), "--device", device)
    result.ends(status, f"{code}: ")
    assert list(tmp_path.iterdir()) == []
