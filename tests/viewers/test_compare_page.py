"""The deployment page: its pictures and figures are the renderers', and a browser compares them alike."""

import base64
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb import metrics
from msb_viewers.deployment.difference import colorize, squared_error
from msb_viewers.deployment.page import page, page_view
from msb_viewers.deployment.shots import Shot
from msb_viewers.deployment.state import CompareState
from tests.viewers.compare import HEIGHT, WIDTH, comparison, flat_shot


def noisy(tier: str, seed: int) -> Shot:
    image = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    return Shot(tier, image, "", 1.0, 10, "test")


SHOTS = {
    "reference": Shot("reference", why="no <b>time</b>"),
    "dedicated": noisy("dedicated", 1),
    "standard": noisy("standard", 2),
}


def made(name: str = "demo.triasset", **more: Any) -> str:
    scene = replace(comparison(missing={"reference": "no time"}), name=name)
    state = CompareState.first(scene, **more)
    return page(state, [page_view(view, SHOTS) for view in scene.views]).decode()


def meta_of(text: str) -> dict[str, Any]:
    found = re.search(r'id="meta">(.*?)</script>', text, re.DOTALL)
    return json.loads(found[1])


def test_the_page_holds_every_picture_exactly() -> None:
    meta = meta_of(made())
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
    found = in_browser(made().encode(), script, size=(1280, 900))
    a, b = SHOTS["dedicated"].image, SHOTS["standard"].image
    wanted = colorize(squared_error(a, b), 0.25).reshape(-1)
    assert np.abs(np.array(found["map"]) - wanted).max() <= 6  # a step of the scale, at most
    text = f"{metrics.psnr(a, b):.2f}"
    assert found["figure"] == f"{text} dB"
    assert found["figures"] == 3
    assert "no <b>time</b>" in found["side"]
    assert (found["at"], found["back"]) == (1, 2)
    assert found["clip"] == "inset(0px 0px 0px 25%)"
    assert found["table"].count(text) == 4  # three cameras and the mean
    assert found["wide"]


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["side", "wipe", "difference"])
def test_a_phone_shows_it_without_scrolling_sideways(in_browser: Callable[..., Any], layout: Any) -> None:
    script = """await Promise.all([...document.images].map((image) => image.decode().catch(() => {})));
      return [...document.querySelectorAll("main *, header *, #controls *")]
        .filter((n) => n.getBoundingClientRect().right > 392).map((n) => n.tagName + n.className);"""
    assert in_browser(made(layout=layout).encode(), script, size=(390, 900)) == []


def test_equal_pictures_are_identical_not_infinite() -> None:
    shots = {tier: flat_shot(tier, (1, 2, 3)) for tier in ("dedicated", "standard")}
    assert page_view(comparison().views[0], shots)["decibels"] == {"dedicated standard": "identical"}
