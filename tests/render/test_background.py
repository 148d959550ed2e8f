"""Every command renders over the background that a model records."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from msb.scenes import turntable, write_cameras
from tests.cli.conftest import INSTALLED, Msb, msb
from tests.conftest import ROOT

__all__ = ["msb"]

MODEL = ROOT / "tests" / "tiny" / "models" / "walled" / "triangle_splatting"
SCENE = ROOT / "tests" / "tiny" / "scenes" / "mipnerf360" / "pebble"
GRAY = "#336699"
GRAY_NUMBERS = [0.2, 0.4, 0.6]


@pytest.fixture(scope="module")
def cameras(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cameras") / "views.json"
    write_cameras(turntable((0, 0, 0), 3, up=(0, 1, 0), count=1, width=24, height=16, fov_y=0.7), path)
    return path


def list_backgrounds(msb: Msb, asset: Path, cameras: Path, out: Path, *more: str) -> dict[str, list[float]]:
    """Return for each command the background over which it renders."""
    views = ("--cameras", cameras, *more)

    def read_background(command: str, *args: object) -> Any:
        result = msb(command, *views, *args, "--json", "-", asset, status=0)
        return result.json["background"]

    backgrounds = {"render": read_background("render", "-o", out / "images", "--force")}
    if "why" in INSTALLED:
        backgrounds["why"] = read_background("why")
    for tier in ("standard", "dedicated") if "web" in INSTALLED else ():
        page = out / f"{tier}.html"
        options = ("--no-verify",) if tier == "dedicated" else ()
        msb("web", *views, "--tier", tier, "--force", *options, "-o", page, asset, status=0)
        (text,) = set(re.findall(r'"background": ?(\[[^]]*\])(?=[^{}]*"daylight")', page.read_text()))
        backgrounds[f"web {tier}"] = json.loads(text)
    if "compare" not in INSTALLED:
        return backgrounds
    page = out / "compare.html"
    tiers = ("--tiers", "dedicated,standard", "--html", page, "--force")
    msb("compare", *views, *tiers, asset, status=0)
    (color,) = re.findall(r"background (#[0-9a-f]{6}|white|black)\"", page.read_text())
    names = {"white": "#ffffff", "black": "#000000"}
    hexed = names.get(color, color)
    backgrounds["compare"] = [int(hexed[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return backgrounds


@pytest.mark.slow
@pytest.mark.parametrize(("stated", "color"), [(GRAY, GRAY_NUMBERS), (None, [0.0, 0.0, 0.0])])
def test_every_command_uses_the_recorded_background_or_the_same_default(
    msb: Msb, cameras: Path, tmp_path: Path, stated: str | None, color: list[float]
) -> None:
    asset = tmp_path / "model.triasset"
    msb("export", "--form", "folder", MODEL, asset, status=0)
    manifest = json.loads((asset / "manifest.json").read_text())
    manifest["appearance"].pop("background")
    manifest["appearance"] |= {} if stated is None else {"background": stated}
    (asset / "manifest.json").write_text(json.dumps(manifest))
    backgrounds = list_backgrounds(msb, asset, cameras, tmp_path)
    assert backgrounds == dict.fromkeys(backgrounds, pytest.approx(color))


@pytest.mark.slow
@pytest.mark.skipif("compare" not in INSTALLED, reason="the viewers are not installed")
def test_another_background_than_the_models_is_a_warning_beside_photographs(msb: Msb, tmp_path: Path) -> None:
    args = ("--cameras", SCENE, "--images", SCENE / "images_4", "--tiers", "dedicated,truth")
    args = (*args, "--html", tmp_path / "c.html", "--force", MODEL)
    code = "warning: CHECKPOINT_CONFIG: "
    assert code in msb("compare", "--background", "white", *args).err
    assert code not in msb("compare", *args).err
    assert code not in msb("compare", "--background", "official", *args).err
