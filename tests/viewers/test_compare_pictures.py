"""What each tier draws, and the composed picture: no VTK, no display."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import metrics
from msb.errors import MetricError
from msb.render.images import to_bytes
from msb_viewers.deployment.arrange import Box
from msb_viewers.deployment.compose import Composer, caption_lines
from msb_viewers.deployment.difference import scale_colors
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


# Shots ---------------------------------------------------------------------------------------------------


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


def test_settings_and_samples_reach_their_tiers() -> None:
    scenes = {
        "plain": comparison(),
        "settings": comparison(settings={"sh_degree": 0, "supersample": 1}),
        "samples": comparison(supersample=3),
    }
    camera, images = scenes["plain"].views[0].camera, {}
    for name, scene in scenes.items():
        with TierRenderers(scene) as renderers:
            for tier in ("dedicated", "standard"):
                images[name, tier] = renderers.shoot(tier, camera).image
    assert (images["settings", "dedicated"] != images["plain", "dedicated"]).any()
    assert (images["samples", "standard"] != images["plain", "standard"]).any()
    # A method's own samples are not those of the standard tier.
    assert (images["samples", "dedicated"] == images["plain", "dedicated"]).all()


def test_a_path_without_a_picture_says_why() -> None:
    scene = comparison(missing={"standard": "it has no static colour"}, tiers=ALL)
    with TierRenderers(scene) as renderers:
        view = scene.views[0]
        assert renderers.shoot("standard", view.camera, view).why == "it has no static colour"
        assert "no photograph" in renderers.shoot("truth", view.camera, view).why
        assert "dataset" in renderers.shoot("truth", view.camera, None).why


def test_a_damaged_photograph_is_an_error(tmp_path: Path) -> None:
    views = photographs(tmp_path, [(1, 2, 3)])
    views[0].photograph.write_bytes(views[0].photograph.read_bytes()[:60])
    scene = comparison(views, ("truth",))
    with TierRenderers(scene) as renderers, pytest.raises(MetricError, match="METRIC_IMAGE"):
        renderers.shoot("truth", views[0].camera, views[0])


# Compositions --------------------------------------------------------------------------------------------


def middle(image: np.ndarray, box: Box, across: float = 0.5, down: float = 0.5) -> tuple[int, ...]:
    x, y = box.left + int(across * box.width), box.top + int(down * box.height)
    return tuple(int(value) for value in image[y, x])


def test_side_by_side_shows_each_path_in_its_place(tmp_path: Path) -> None:
    state = CompareState.first(comparison(photographs(tmp_path, [(0, 0, 0)]), ALL))
    composed = Composer().compose(state, flat_shots(ALL), (1280, 800))
    assert list(composed.pictures) == list(ALL)
    for tier, box in composed.pictures.items():
        assert middle(composed.image, box) == FLAT[tier]
        assert middle(composed.image, box, 0.01, 0.01) == FLAT[tier]
        assert box.width / box.height == pytest.approx(WIDTH / HEIGHT, rel=0.02)
        below = composed.image[box.bottom + 2 : box.bottom + 60, box.left : box.right].astype(int)
        assert (np.abs(below - BACKGROUND).max(axis=2) > 100).sum() > 100  # a caption
    assert composed.divider is None


@pytest.mark.parametrize("divider", [0.0, 0.3, 0.5, 1.0])
def test_the_wipe_shows_a_left_and_b_right_of_the_divider(divider: float) -> None:
    state = CompareState.first(comparison(), layout="wipe")
    state.divider = divider
    composed = Composer().compose(state, flat_shots(state.pair), (1000, 700))
    box = composed.pictures["wipe"]
    assert composed.divider.holds(box.left + divider * box.width, box.top + 10)
    for across in (0.02, 0.2, 0.4, 0.6, 0.8, 0.98):
        if abs(across - divider) > 0.05:
            wanted = state.pair[0] if across < divider else state.pair[1]
            assert middle(composed.image, box, across, 0.7) == FLAT[wanted]


def test_the_difference_is_coloured_and_measured() -> None:
    state = CompareState.first(comparison(), layout="difference")
    shots = {
        "dedicated": flat_shot("dedicated", (100, 100, 100)),
        "standard": flat_shot("standard", (151, 151, 151)),
    }
    composer = Composer()
    found = composer.decibels(shots["dedicated"], shots["standard"])
    assert found == metrics.psnr(shots["dedicated"].image, shots["standard"].image)
    for top in (0.5, 0.25):
        state.top = top
        composed = composer.compose(state, shots, (1000, 700))
        wanted = scale_colors()[int(min(51 / top, 255))]
        assert np.abs(np.array(middle(composed.image, composed.pictures["difference"])) - wanted).max() <= 2
    assert middle(composed.image, composed.pictures["dedicated"]) == (100, 100, 100)
    box = composed.pictures["difference"]
    below = composed.image[box.bottom : box.bottom + 90, box.left + 4 : box.right - 4].astype(int)
    ends = np.abs(below[:, [0, -1]] - scale_colors()[[0, -1]]).max(axis=(1, 2))
    assert (ends <= 8).sum() >= 8  # rows of the legend's bar


def test_pictures_of_two_sizes_are_not_compared() -> None:
    state = CompareState.first(comparison(), layout="difference")
    small = flat_shot("standard", (0, 0, 0), (WIDTH // 2, HEIGHT // 2))
    shots = {**flat_shots(("dedicated",)), "standard": small}
    composer = Composer()
    assert composer.decibels(shots["dedicated"], small) is None
    composed = composer.compose(state, shots, (900, 600))
    assert middle(composed.image, composed.pictures["difference"], 0.5, 0.1) == (226, 227, 229)


def test_what_is_missing_is_said_in_its_place() -> None:
    state = CompareState.first(comparison())
    shots = {**flat_shots(("standard",)), "dedicated": Shot("dedicated", why="too little memory")}
    for layout in LAYOUTS:
        state.layout = layout
        bare = Composer().compose(state, {}, (1000, 700)).image
        composed = Composer().compose(
            state, shots, (1000, 700), busy={"reference": "computing 64 x 48 in NumPy: 3 s"}
        )
        assert (composed.image != bare).any()
        box = next(iter(composed.pictures.values()))
        assert middle(composed.image, box, 0.5, 0.1) == (226, 227, 229)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("size", [(64, 64), (200, 1200), (2560, 300), (800, 500)])
def test_windows_of_any_shape_and_long_names_are_no_error(layout: Any, size: tuple[int, int]) -> None:
    state = CompareState.first(replace(comparison(), name="a very long name " * 20), layout=layout)
    state.message = "word " * 300
    for state.help, state.captions in ((False, True), (True, False)):
        image = Composer().compose(state, flat_shots(state.comparison.tiers), size).image
        assert image.shape == (size[1], size[0], 3)
        if size == (800, 500) and not state.help:
            assert (image[:, -3:] == BACKGROUND).all()


def test_captions_tell_time_memory_size_and_place() -> None:
    shot = flat_shot("standard", (0, 0, 0))
    assert caption_lines(shot, None) == [
        "12.3 ms, 5.6 MB on the device, 64 x 48",
        "OpenCL on test",
    ]
    assert caption_lines(shot, "computing")[1] == "computing"
    assert caption_lines(None, "waiting") == ["waiting"]
    slow = Shot("reference", shot.image, milliseconds=65432.1)
    assert caption_lines(slow, None)[0].startswith("65.4 s, ")


@pytest.mark.slow
def test_a_composer_forgets() -> None:
    state, composer = CompareState.first(comparison()), Composer()
    for number in range(60):
        shots = {tier: flat_shot(tier, (number, 0, 0)) for tier in state.comparison.tiers}
        composed = composer.compose(state, shots, (600, 400))
        assert middle(composed.image, composed.pictures["standard"]) == (number, 0, 0)
    assert len(composer._kept) <= 40
