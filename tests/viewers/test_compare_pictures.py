"""What each tier draws, and the composed picture: no VTK, no display."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import metrics
from msb.render.images import to_bytes
from msb_viewers.deployment.arrange import Box
from msb_viewers.deployment.compose import compose, decibels
from msb_viewers.deployment.difference import TOP, scale_colors
from msb_viewers.deployment.shots import Shot, TierRenderers
from msb_viewers.deployment.state import LAYOUTS, CompareState
from msb_viewers.palette import BACKGROUND
from tests.viewers.compare import (
    FLAT,
    HEIGHT,
    WIDTH,
    checkpoint_asset,
    comparison,
    flat_shot,
    flat_shots,
    photographs,
)

ALL = ("truth", "reference", "dedicated", "standard")


def test_each_path_gives_what_msb_render_gives(tmp_path: Path) -> None:
    color = (0.25, 0.5, 1.0)
    settings = {"supersample": 1}
    views = photographs(tmp_path, [(10, 20, 30)])
    scene = comparison(views, ALL, background=color, settings=settings)
    view = scene.views[0]
    with TierRenderers(scene) as renderers:
        shots = renderers.shoot_all(view)
    assert list(shots) == list(ALL)
    for tier in ("reference", "dedicated", "standard"):
        frame = msb.render(checkpoint_asset(), view.camera, tier=tier, background=color, settings=settings)
        image, shot = shots[tier].image, shots[tier]
        assert np.abs(image.astype(int) - to_bytes(frame.image)).max() <= 1, tier
        assert shot.milliseconds > 0
    assert (shots["truth"].image == (10, 20, 30)).all()
    assert shots["truth"].milliseconds is None
    assert shots["reference"].nbytes is None
    assert "NumPy" in shots["reference"].where
    assert (shots["standard"].nbytes or 0) > view.camera.width * view.camera.height * 12
    assert shots["standard"].where.startswith("OpenCL on ")


def test_a_path_without_a_picture_says_why() -> None:
    scene = comparison(missing={"standard": "no colour"}, tiers=ALL)
    with TierRenderers(scene) as renderers:
        view = scene.views[0]
        assert renderers.shoot("standard", view).why == "no colour"
        assert renderers.shoot("truth", view).why == view.why


def middle(image: np.ndarray, box: Box, across: float = 0.5, down: float = 0.5) -> tuple[int, ...]:
    x, y = box.left + int(across * box.width), box.top + int(down * box.height)
    return tuple(int(value) for value in image[y, x])


def test_side_by_side_shows_each_path_in_its_place(tmp_path: Path) -> None:
    state = CompareState.first(comparison(photographs(tmp_path, [(0, 0, 0)]), ALL))
    composed = compose(state, flat_shots(ALL), (1280, 800))
    assert list(composed.pictures) == list(ALL)
    for tier, box in composed.pictures.items():
        assert middle(composed.image, box) == FLAT[tier]
        assert middle(composed.image, box, 0.01, 0.01) == FLAT[tier]
        assert box.width / box.height == pytest.approx(WIDTH / HEIGHT, rel=0.02)
        below = composed.image[box.bottom + 2 : box.bottom + 60, box.left : box.right].astype(int)
        assert (np.abs(below - BACKGROUND).max(axis=2) > 100).sum() > 100  # a caption


def test_the_wipe_shows_a_left_and_b_right_of_the_divider() -> None:
    state = CompareState.first(comparison(), layout="wipe")
    composed = compose(state, flat_shots(state.pair), (1000, 700))
    box = composed.pictures["wipe"]
    for across in (0.02, 0.2, 0.4, 0.6, 0.8, 0.98):
        assert middle(composed.image, box, across, 0.7) == FLAT[state.pair[across > 0.5]]


def test_the_difference_is_coloured_and_measured() -> None:
    state = CompareState.first(comparison(), layout="difference")
    shots = {
        "dedicated": flat_shot("dedicated", (100, 100, 100)),
        "standard": flat_shot("standard", (151, 151, 151)),
    }
    found = decibels(shots["dedicated"], shots["standard"])
    assert found == metrics.psnr(shots["dedicated"].image, shots["standard"].image)
    composed = compose(state, shots, (1000, 700))
    wanted = scale_colors()[int(51 / TOP)]
    assert np.abs(np.array(middle(composed.image, composed.pictures["difference"])) - wanted).max() <= 2
    assert middle(composed.image, composed.pictures["dedicated"]) == (100, 100, 100)
    box = composed.pictures["difference"]
    below = composed.image[box.bottom : box.bottom + 90, box.left + 4 : box.right - 4].astype(int)
    ends = np.abs(below[:, [0, -1]] - scale_colors()[[0, -1]]).max(axis=(1, 2))
    assert (ends <= 8).sum() >= 8  # rows of the legend's bar


def test_a_tier_without_a_picture_has_a_placeholder_in_every_layout() -> None:
    shots = {tier: Shot(tier, why="too little memory") for tier in ("reference", "dedicated", "standard")}
    for layout in LAYOUTS:
        composed = compose(CompareState.first(comparison(), layout=layout), shots, (1000, 700))
        box = next(iter(composed.pictures.values()))
        assert middle(composed.image, box, 0.5, 0.1) == (226, 227, 229)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("size", [(64, 64), (200, 1200), (2560, 300)])
def test_pictures_of_any_shape_and_long_names_are_no_error(layout: Any, size: tuple[int, int]) -> None:
    state = CompareState.first(replace(comparison(), name="a very long name " * 20), layout=layout)
    image = compose(state, flat_shots(state.comparison.tiers), size).image
    assert image.shape == (size[1], size[0], 3)
