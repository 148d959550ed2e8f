"""`msb.compare` does what `msb compare` does, and returns the PSNR of every view."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import msb
from msb.errors import UsageError
from msb.metrics import psnr, read_image
from msb.metrics.ground_truth import ground_truth
from msb.render.images import to_bytes
from msb.scenes.datasets import read_scene
from tests.cli.conftest import Here, here
from tests.conftest import ROOT

__all__ = ["here"]

CHECKPOINT = ROOT / "data_stubs" / "checkpoint"
VIEWS = ROOT / "data_stubs" / "views.json"
SCENE = ROOT / "data_stubs" / "scenes" / "nerf_synthetic" / "pebble"
MODEL = ROOT / "data_stubs" / "models" / "pebble" / "mesh_splatting"


@pytest.mark.slow
def test_the_function_writes_the_files_of_the_command(here: Here, tmp_path: Path) -> None:
    files = ["--html", tmp_path / "command.html", "--screenshot", tmp_path / "command.png"]
    here("compare", "--tiers", "dedicated,standard", "--scale", "0.25", "--camera", "0", "--cameras", VIEWS,
         *files, CHECKPOINT)  # fmt: skip
    written = (tmp_path / "python.html", tmp_path / "python.png")
    options: dict[str, Any] = {"html": written[0], "screenshot": written[1]}
    done = msb.compare(CHECKPOINT, VIEWS, **options, tiers=["dedicated", "standard"], scale=0.25, views=["0"])
    assert done.written == written
    assert done.tiers == ("dedicated", "standard")
    # The captions have times, so the files differ in a few bytes. The renderings are the same.
    images = [
        re.findall(r"data:image/png;base64,[\w+/=]+", path.read_text())
        for path in (written[0], Path(files[1]))
    ]
    assert images[0] == images[1] != []
    assert read_image(written[1]).shape == read_image(Path(files[3])).shape
    with pytest.raises(UsageError, match="OUTPUT_EXISTS"):
        msb.compare(CHECKPOINT, VIEWS, html=written[0])


def test_every_view_has_the_psnr_of_its_renderings_and_photograph() -> None:
    asset, scene = msb.open(MODEL), read_scene(SCENE)
    cameras = scene.test[:2]
    done = msb.compare(
        asset, SCENE, views=["0", "1"], tiers=["truth", "standard", "baked"], baked=asset, background="white"
    )
    assert list(done.psnr) == [camera.name for camera in cameras]
    for camera in cameras:
        values = done.psnr[str(camera.name)]
        frame = to_bytes(asset.render(camera, background=(1, 1, 1)).image)
        truth = ground_truth(replace(scene, background=(1.0, 1.0, 1.0)), camera)
        assert math.isinf(values["baked", "standard"])
        assert values["standard", "truth"] == pytest.approx(psnr(frame, truth), abs=0.01)


@pytest.mark.parametrize(
    "options",
    [
        {"scale": 0.5},
        {"views": ["0"]},
        {"scene": VIEWS, "scale": 0.0},
        {"scene": VIEWS, "layout": "behind"},
        {"scene": VIEWS, "tiers": ["best"]},
        {"scene": VIEWS, "html": "a.png"},
        {"scene": VIEWS, "pair": ("dedicated", "dedicated")},
    ],
)
def test_invalid_arguments_are_rejected(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError):
        msb.compare(CHECKPOINT, **options)
