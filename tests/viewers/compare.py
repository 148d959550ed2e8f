"""Comparisons for tests: the demo checkpoint with small cameras, and images of uniform colour."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import msb
from data_stubs.make import cameras
from msb.registry import TIERS
from msb_viewers.deployment.shots import LABELS, Comparison, Shot
from msb_viewers.deployment.views import View, dataset_views
from tests.conftest import ROOT

CHECKPOINT = ROOT / "data_stubs" / "checkpoint"
WIDTH, HEIGHT = 64, 48


@cache
def checkpoint_asset() -> msb.Asset:
    return msb.export(CHECKPOINT)


def small_cameras(count: int = 3) -> list[msb.Camera]:
    return [camera.resized(WIDTH, HEIGHT) for camera in cameras()[:count]]


def photographs(folder: Path, colors: list[tuple[int, int, int]]) -> list[View]:
    """Return views with photographs of uniform colour."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen = small_cameras(len(colors))
    for camera, color in zip(chosen, colors, strict=True):
        Image.new("RGB", (WIDTH, HEIGHT), color).save(folder / f"{camera.name}.png")
    return dataset_views(chosen, folder)


def comparison(views: list[View] | None = None, tiers: tuple[str, ...] = TIERS, **more: Any) -> Comparison:
    chosen = dataset_views(small_cameras()) if views is None else views
    asset = more.pop("asset", None) or checkpoint_asset()
    return Comparison("demo.triasset", asset, tiers, more.pop("missing", {}), tuple(chosen), **more)


def flat_shots(tiers: tuple[str, ...], size: tuple[int, int] = (WIDTH, HEIGHT)) -> dict[str, Shot]:
    """Return an image of uniform colour for each tier."""
    return {tier: flat_shot(tier, FLAT[tier], size) for tier in tiers}


FLAT = dict(
    zip(LABELS, [(200, 40, 40), (40, 200, 40), (40, 40, 200), (200, 200, 40), (40, 200, 200)], strict=True)
)


def flat_shot(tier: str, color: tuple[int, int, int], size: tuple[int, int] = (WIDTH, HEIGHT)) -> Shot:
    image = np.full((size[1], size[0], 3), color, np.uint8)
    return Shot(tier, image, "", 12.34, 5_600_000, "OpenCL on test")
