"""Engines on the command line: listed, used by name, and the page that is written."""

from pathlib import Path

import numpy as np
import pytest

from msb.engines.blender import VARIABLE as BLENDER
from msb.engines.browser import VARIABLE as BROWSER
from msb.render.backend import ENGINES
from tests.cli.conftest import Here, Msb, devices, here, msb, tried
from tests.conftest import ROOT
from tests.engines.conftest import need

pytestmark = pytest.mark.slow

__all__ = ["devices", "here", "msb", "tried"]
VIEWS = ROOT / "data_stubs" / "views.json"


def test_devices_lists_renderers_and_what_is_missing(devices: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BROWSER, "no-such-browser")
    monkeypatch.setenv(BLENDER, "no-such-python")
    result = devices()
    lines = result.out.splitlines()
    rows = [line.split() for line in lines]
    assert ["standard", "yes"] in rows
    for name in ENGINES:
        assert any(row and row[0] == name for row in rows)
    assert "apt-get install chromium" in result.out or "MSB_BROWSER" in result.out
    assert max(map(len, lines)) <= 80
    listed = {row["name"]: row for row in devices("--json", "-").json["renderers"]}
    assert listed["standard"].keys() == {"name", "from", "missing"}
    assert listed["standard"]["missing"] is None
    assert "MSB_BROWSER" in listed["threejs"]["missing"]
    assert "MSB_BLENDER" in listed["blender_cycles"]["missing"]
    assert ["threejs", "no"] in [line.split() for line in devices("-q").out.splitlines()]


def test_render_and_bench_with_an_engine(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    need("wgpu")
    common = ("--cameras", VIEWS, "--camera", "0", "--scale", "0.25", "--json", "-")
    ours = msb("render", *common, "--format", "npy", "-o", tmp_path / "ours", demo_asset)
    theirs = msb(
        "render", *common, "--format", "npy", "-o", tmp_path / "wgpu", "--renderer", "wgpu", demo_asset
    )
    assert theirs.err == ""
    assert theirs.json["renderer"].startswith("wgpu ")
    images = [np.load(result.json["frames"][0]["image"]) for result in (ours, theirs)]
    assert (np.abs(images[0] - images[1]).max(axis=2) < 1 / 255).mean() > 0.999
    timed = ("--repeat", "2", "--seconds", "0")
    record = msb("bench", *common, *timed, "--renderer", "wgpu", demo_asset).json
    assert set(record["machine"]["device"]) == {"platform", "name", "kind"}
    assert record["fps"] > 0


def test_the_page_holds_the_asset_and_its_cameras(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    result = msb("web", "--out", page, "--cameras", VIEWS, "--background", "black", demo_asset)
    assert (result.status, result.out, result.err) == (0, f"{page}\n", "")
    text = page.read_text()
    assert '"name": "turntable_00000"' in text
    assert '"background": [0.0, 0.0, 0.0]' in text
    assert len(text) > 1_000_000
    again = msb("web", "--out", page, demo_asset)
    assert again.status == 2
    assert again.err.startswith("OUTPUT_EXISTS: ")


STUBS = ROOT / "data_stubs"
MESH = ROOT / "tests" / "golden" / "meshes" / "synthetic_splat_small.ply"


@pytest.mark.parametrize(
    ("line", "model", "code"),
    [
        ("web -o a.png", None, "USAGE"),
        ("web -o a.html --cameras views.json", None, "USAGE"),
        ("web -o a.html --up +z", None, "USAGE"),
        ("web -o a.html --background official", None, "USAGE"),
        ("web -o a.html --camera 0", STUBS / "splat_like.triasset", "USAGE"),
        ("web", None, "USAGE"),
        ("web -o a.html --tier standard", STUBS / "models" / "pebble" / "diffsoup", "UNSUPPORTED_TIER"),
        ("web -o a.html --tier dedicated", MESH, "UNSUPPORTED_TIER"),
        ("render -o a --turntable 1 --tier dedicated", MESH, "UNSUPPORTED_TIER"),
        ("render -o a --turntable 1 --renderer threejs", STUBS / "splat_like.triasset", "ENGINE_MISSING"),
    ],
)
def test_what_makes_no_sense_is_refused(
    msb: Msb, tmp_path: Path, line: str, model: Path | None, code: str
) -> None:
    options = {"cwd": tmp_path, BROWSER: "no-such-browser"}
    result = msb(*line.split(), *([model] if model else []), **options)
    assert result.status == (4 if code == "UNSUPPORTED_TIER" else 2)
    assert result.err.splitlines()[-1].startswith(f"{code}: ")
    assert not list(tmp_path.iterdir())


def test_an_empty_page_needs_no_asset(msb: Msb, tmp_path: Path) -> None:
    assert msb("web", "--out", tmp_path / "empty.html").status == 0
    assert (tmp_path / "empty.html").stat().st_size < 1_000_000
