"""The page and the image of a comparison, and its maps and PSNRs in a browser."""

import base64
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from msb import metrics
from msb.render.images import to_bytes
from msb_viewers.deployment.arrange import Box
from msb_viewers.deployment.compose import compose, decibels
from msb_viewers.deployment.difference import TOP, colorize, scale_colors, squared_error
from msb_viewers.deployment.page import page, page_view
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


def noisy(tier: str, seed: int) -> Shot:
    image = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    return Shot(tier, image, "", 1.0, 10, "test")


SHOTS = {
    "reference": Shot("reference", why="no <b>time</b>"),
    "dedicated": noisy("dedicated", 1),
    "standard": noisy("standard", 2),
}


def page_text(name: str = "demo.triasset", **more: Any) -> str:
    scene = replace(comparison(missing={"reference": "no time"}), name=name)
    state = CompareState.first(scene, **more)
    return page(state, [page_view(view, SHOTS) for view in scene.views]).decode()


def meta_of(text: str) -> dict[str, Any]:
    result = re.search(r'id="meta">(.*?)</script>', text, re.DOTALL)
    return json.loads(result[1])


def test_the_page_contains_lossless_images() -> None:
    meta = meta_of(page_text())
    assert len(meta["views"]) == 3
    for view in meta["views"]:
        for tier, shot in SHOTS.items():
            stored = view["shots"][tier]
            if shot.image is None:
                assert stored["image"] is None
                assert stored["why"] == shot.why
                continue
            raw = base64.b64decode(stored["image"].removeprefix("data:image/png;base64,"))
            with Image.open(io.BytesIO(raw)) as image:
                assert (np.asarray(image) == shot.image).all()
        wanted = metrics.psnr(SHOTS["dedicated"].image, SHOTS["standard"].image)
        assert view["decibels"] == {"dedicated standard": wanted}


@pytest.mark.slow
def test_a_browser_draws_the_same_map_and_figures(in_browser: Callable[..., Any]) -> None:
    script = """
      const result = {};
      setLayout("difference");
      while (!document.getElementById("figure")) await new Promise((r) => setTimeout(r, 20));
      const canvas = byId("heat"), all = [0, 0, canvas.width, canvas.height];
      const data = canvas.getContext("2d").getImageData(...all).data;
      result.map = Array.from(data).filter((_, i) => i % 4 < 3);
      result.figure = byId("figure").textContent;
      setLayout("side"); result.side = byId("side").textContent;
      result.figures = byId("side").children.length;
      step(1); result.at = state.at; step(-1); step(-1); result.back = state.at;
      setLayout("wipe"); const slider = byId("across"); slider.value = 250; slider.oninput();
      result.clip = document.querySelector(".wipe img + img").style.clipPath;
      result.table = byId("scores").textContent;
      result.wide = document.documentElement.scrollWidth <= innerWidth;
      return result;"""
    result = in_browser(page_text().encode(), script, size=(1280, 900))
    a, b = SHOTS["dedicated"].image, SHOTS["standard"].image
    wanted = colorize(squared_error(a, b), 0.25).reshape(-1)
    assert np.abs(np.array(result["map"]) - wanted).max() <= 6  # one step of the colour scale
    text = f"{metrics.psnr(a, b):.2f}"
    assert result["figure"] == f"{text} dB"
    assert result["figures"] == 3
    assert "no <b>time</b>" in result["side"]
    assert (result["at"], result["back"]) == (1, 2)
    assert result["clip"] == "inset(0px 0px 0px 25%)"
    assert result["table"].count(text) == 4  # one row per camera (3) and one for the average
    assert result["wide"]


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["side", "wipe", "difference"])
def test_a_phone_shows_it_without_scrolling_sideways(in_browser: Callable[..., Any], layout: Any) -> None:
    script = """await Promise.all([...document.images].map((image) => image.decode().catch(() => {})));
      return [...document.querySelectorAll("main *, header *, #controls *")]
        .filter((n) => n.getBoundingClientRect().right > 392).map((n) => n.tagName + n.className);"""
    assert in_browser(page_text(layout=layout).encode(), script, size=(390, 900)) == []


def test_equal_images_have_no_infinite_psnr() -> None:
    shots = {tier: flat_shot(tier, (1, 2, 3)) for tier in ("dedicated", "standard")}
    assert page_view(comparison().views[0], shots)["decibels"] == {"dedicated standard": "identical"}


ALL = ("truth", "reference", "dedicated", "standard")


def test_each_tier_has_the_image_of_msb_render(tmp_path: Path) -> None:
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


def test_a_tier_without_an_image_has_a_reason() -> None:
    scene = comparison(missing={"standard": "no colour"}, tiers=ALL)
    with TierRenderers(scene) as renderers:
        view = scene.views[0]
        assert renderers.shoot("standard", view).why == "no colour"
        assert renderers.shoot("truth", view).why == view.why


def middle(image: np.ndarray, box: Box, across: float = 0.5, down: float = 0.5) -> tuple[int, ...]:
    x, y = box.left + int(across * box.width), box.top + int(down * box.height)
    return tuple(int(value) for value in image[y, x])


def test_side_by_side_shows_each_tier_in_its_box(tmp_path: Path) -> None:
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
    result = decibels(shots["dedicated"], shots["standard"])
    assert result == metrics.psnr(shots["dedicated"].image, shots["standard"].image)
    composed = compose(state, shots, (1000, 700))
    wanted = scale_colors()[int(51 / TOP)]
    assert np.abs(np.array(middle(composed.image, composed.pictures["difference"])) - wanted).max() <= 2
    assert middle(composed.image, composed.pictures["dedicated"]) == (100, 100, 100)
    box = composed.pictures["difference"]
    below = composed.image[box.bottom : box.bottom + 90, box.left + 4 : box.right - 4].astype(int)
    ends = np.abs(below[:, [0, -1]] - scale_colors()[[0, -1]]).max(axis=(1, 2))
    assert (ends <= 8).sum() >= 8  # rows of the colour scale


def test_a_tier_without_an_image_has_a_placeholder() -> None:
    shots = {tier: Shot(tier, why="too little memory") for tier in ("reference", "dedicated", "standard")}
    for layout in LAYOUTS:
        composed = compose(CompareState.first(comparison(), layout=layout), shots, (1000, 700))
        box = next(iter(composed.pictures.values()))
        assert middle(composed.image, box, 0.5, 0.1) == (226, 227, 229)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("size", [(64, 64), (200, 1200), (2560, 300)])
def test_any_image_size_and_long_names_are_composed(layout: Any, size: tuple[int, int]) -> None:
    state = CompareState.first(replace(comparison(), name="a very long name " * 20), layout=layout)
    image = compose(state, flat_shots(state.comparison.tiers), size).image
    assert image.shape == (size[1], size[0], 3)
