"""Photographs supervise a bake with the geometry "auto" if they gain enough."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.bake import supervision
from msb.bake.options import BakeOptions
from msb.render.images import write_image
from msb.scenes.datasets import Scene
from tests.bake.soups import MODELS, sparse

MODEL = MODELS / "pebble" / "triangle_splatting"


def photographed(folder: Path, change: float) -> Scene:
    """Return a shipped scene. Its photographs are native renderings of the model, brighter by `change`."""
    scene = sparse("nerf_synthetic/pebble", "triangle_splatting")
    model = msb.open(MODEL)
    views: dict[str, tuple[Any, ...]] = {"train": (), "test": ()}
    for split in views:
        for number, camera in enumerate(getattr(scene, split)[:8]):
            image = model.render(camera, background=scene.background).image
            path = folder / f"{split}_{number}.png"
            write_image(path, np.clip(image + change, 0, 1).astype(np.float32), "png")
            views[split] += (replace(camera, image_path=path),)
    return replace(scene, **views, mask_source=None)


@pytest.mark.slow
@pytest.mark.parametrize(("least", "chosen"), [(99.0, "native"), (0.5, "photographs")])
def test_photographs_are_chosen_if_they_gain_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, least: float, chosen: str
) -> None:
    scene = photographed(tmp_path, 0.25)
    monkeypatch.setattr(supervision, "_MIN_GAIN", least)
    report = msb.bake(MODEL, scene=scene, color="vertex", seconds=0).report
    assert report.supervision == chosen
    gain = report.supervisions["photographs"] - report.supervisions["native"]
    assert (gain >= least) == (chosen == "photographs")
    assert report.to_dict()["supervisions"] == report.supervisions


@pytest.mark.parametrize(
    "options", [{"geometry": "kept"}, {"geometry": "auto", "supervision": "native"}, {"geometry": "surface"}]
)
def test_one_supervision_is_tried_if_the_user_chose(
    monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]
) -> None:
    tried: list[str] = []

    def attempt(_inputs: object, _options: object, name: str, *_: object) -> Any:
        tried.append(name)
        return name

    monkeypatch.setattr(supervision, "_make_attempt", attempt)
    inputs = supervision.BakeInputs(msb.open(MODEL), None, None, None, None, None, lambda *_: False)
    found = supervision.make_best_attempt(inputs, BakeOptions(**options), Any, lambda: False)  # type: ignore[arg-type]
    assert (tried, found) == (["native"], ("native", {}, []))
