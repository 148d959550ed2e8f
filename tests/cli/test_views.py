"""Commands use the cameras of the training, and report devices that do not exist."""

from pathlib import Path

import pytest
from PIL import Image

from tests.cli.conftest import INSTALLED, Here, Msb, of_installed
from tests.conftest import ROOT
from tests.test_views import CAPTURE


@pytest.mark.slow
@pytest.mark.skipif("trial" not in INSTALLED, reason="msb.trial is not installed")
def test_trial_uses_the_cameras_of_the_training(msb: Msb) -> None:
    result = msb("trial", "--task", "decimate_50", "--json", "-", CAPTURE)
    cameras = result.json["cameras"]
    assert (cameras["count"], cameras["from"]) == (12, "training")
    numbers = result.json["trials"][0]["numbers"]["fast_simplification"]
    assert numbers["psnr"] == pytest.approx(26.4, abs=0.3)
    assert cameras["views"] in msb("trial", "--task", "solid", CAPTURE).out


@pytest.mark.skipif("eval" not in INSTALLED, reason="msb.bench is not installed")
def test_uniform_renderings_have_no_numbers(here: Here, tmp_path: Path) -> None:
    pytest.importorskip("skimage", reason="extra bench is not installed")
    photographs = ROOT / "data_stubs/scenes/tanksandtemples/pebble/images"
    for folder in ("empty", "true"):
        (tmp_path / folder).mkdir()
    for path in sorted(photographs.iterdir())[:2]:
        with Image.open(path) as image:
            image.save(tmp_path / "true" / f"{path.stem}.png")
            Image.new("RGB", image.size, "white").save(tmp_path / "empty" / f"{path.stem}.png")
    document = here("eval", "--json", "-", tmp_path / "empty", tmp_path / "true").json
    assert set(document["mean"].values()) == {None}
    assert document["images"][0]["psnr"] is None
    assert document["reason"] in here("eval", tmp_path / "empty", tmp_path / "true").err


@pytest.mark.skipif("web" not in INSTALLED, reason="msb.engines is not installed")
@pytest.mark.slow
@pytest.mark.parametrize("tier", ["standard", "dedicated"])
def test_a_page_has_the_cameras_of_the_training(msb: Msb, tmp_path: Path, tier: str) -> None:
    page = tmp_path / "page.html"
    result = msb("web -o", page, "--tier", tier, *(["--no-verify"] if tier == "dedicated" else []), CAPTURE)
    assert "12 of 57" in result.err
    assert page.read_text("utf-8").count('"world_to_camera"') >= 12


@pytest.mark.parametrize(
    "command",
    of_installed(
        "trial --task uv data_stubs/splat_like.triasset",
        "repair data_stubs/checkpoint NEW.ply",
        "render --turntable 1 -o NEW data_stubs/checkpoint",
    ),
)
@pytest.mark.parametrize(
    ("device", "status", "code"),
    [("foo", 5, "DEVICE_NOT_FOUND"), ("nan", 5, "DEVICE_NOT_FOUND"), (":", 2, "DEVICE_SELECTOR")],
)
def test_a_missing_device_is_an_error(
    here: Here, tmp_path: Path, command: str, device: str, status: int, code: str
) -> None:
    result = here(*command.replace("NEW", str(tmp_path / "new")).split(), "--device", device)
    result.ends(status, f"{code}: ")
    assert list(tmp_path.iterdir()) == []
