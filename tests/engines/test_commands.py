"""Engines on the command line: `msb devices`, `msb render --renderer`, `msb web`."""

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
STUBS = ROOT / "data_stubs"
VIEWS = STUBS / "views.json"
ASSET = STUBS / "splat_like.triasset"
MESH = ROOT / "tests" / "golden" / "meshes" / "synthetic_splat_small.ply"


def test_devices_lists_renderers_and_missing_programs(devices: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BROWSER, "no-such-browser")
    monkeypatch.setenv(BLENDER, "no-such-python")
    result = devices()
    lines = result.out.splitlines()
    rows = [line.split() for line in lines]
    assert ["standard", "yes"] in rows
    assert {row[0] for row in rows if row} >= set(ENGINES)
    assert "MSB_BROWSER" in result.out
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
    ours, theirs = (
        msb("render", *common, "--format", "npy", "-o", tmp_path / name, "--renderer", name, demo_asset)
        for name in ("standard", "wgpu")
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
    assert msb("web", "--out", page, demo_asset, status=2).err.startswith("OUTPUT_EXISTS: ")
    msb("web", "--out", tmp_path / "empty.html", status=0)
    assert (tmp_path / "empty.html").stat().st_size < 1_000_000


@pytest.mark.parametrize(
    ("line", "model", "code"),
    [
        ("web -o a.png", None, "USAGE"),
        ("web -o a.html --cameras views.json", None, "USAGE"),
        ("web -o a.html --up +z", None, "USAGE"),
        ("web -o a.html --background official", None, "USAGE"),
        ("web -o a.html --camera 0", ASSET, "USAGE"),
        ("web", None, "USAGE"),
        ("web -o a.html --quantise", ASSET, "USAGE"),
        ("web -o a.html --at-least 3", ASSET, "USAGE"),
        ("web -o a.html --tier dedicated", None, "USAGE"),
        ("web --verify a.html --quantise", None, "USAGE"),
        ("web -o a.html --tier standard", STUBS / "models" / "pebble" / "diffsoup", "UNSUPPORTED_TIER"),
        ("web -o a.html --tier dedicated", MESH, "UNSUPPORTED_TIER"),
        ("render -o a --turntable 1 --tier dedicated", MESH, "UNSUPPORTED_TIER"),
        ("render -o a --turntable 1 --renderer threejs", ASSET, "ENGINE_MISSING"),
    ],
)
def test_invalid_arguments_are_rejected(
    msb: Msb, tmp_path: Path, line: str, model: Path | None, code: str
) -> None:
    options = {"cwd": tmp_path, BROWSER: "no-such-browser"}
    result = msb(*line.split(), *([model] if model else []), **options)
    assert result.status == (4 if code == "UNSUPPORTED_TIER" else 2)
    assert result.err.splitlines()[-1].startswith(f"{code}: ")
    assert not list(tmp_path.iterdir())
