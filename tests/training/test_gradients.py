"""Derivatives against finite differences, where images have them; else against differences of expectations.

Windows end at their edges, and weights below 1/255 are cut: there the image jumps, by 1/255 or less. Single
numbers among many may sit there, so most must agree closely, and all of them together.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from data_stubs.training import diffsoup, mesh_splatting, triangle_splatting, two_dts
from data_stubs.training.composite import composite
from data_stubs.training.lattice import node_count
from msb.scenes import Camera

CAMERA = Camera.look_at((0.1, -0.2, -4), (0, 0, 0), up=(0, -1, 0), width=20, height=14, fov_y=0.7)
BACKGROUND = np.array([0.2, 0.5, 0.9])


def triangles(count: int, seed: int, size: float = 0.8) -> np.ndarray:
    """Return triangles (count, 3, 3) around the origin."""
    random = np.random.default_rng(seed)
    return random.uniform(-0.8, 0.8, (count, 1, 3)) + random.normal(0, size, (count, 3, 3))


def soup(names: tuple[str, str, str, str], count: int = 5, seed: int = 0) -> dict[str, np.ndarray]:
    """Return parameters with places, opacity logits and SH of degree 2."""
    random = np.random.default_rng(seed + 100)
    parts = (
        triangles(count, seed),
        random.uniform(-1.0, 0.5, (count, 1)),
        random.normal(0.3, 0.6, (count, 1, 3)),
        random.normal(0, 0.2, (count, 8, 3)),
    )
    return dict(zip(names, parts, strict=True))


def tensors(values: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return fresh tensors that ask for derivatives."""
    return {name: torch.from_numpy(value.copy()).requires_grad_() for name, value in values.items()}


STEP, MOST = 1e-6, 16
"""Of each parameter so many numbers are moved, those with the largest derivatives among them."""


def slope(
    function: Callable[[dict[str, Any]], Any], values: dict[str, np.ndarray], name: str, place: int
) -> float:
    """Return the derivative of a number by one value, as a central difference."""
    ends = []
    for sign in (1, -1):
        moved = values | {name: values[name].copy()}
        moved[name].flat[place] += sign * STEP
        ends.append(float(function(tensors(moved)).detach()))
    return (ends[0] - ends[1]) / (2 * STEP)


def check(function: Callable[[dict[str, Any]], Any], values: dict[str, np.ndarray]) -> None:
    parameters = tensors(values)
    function(parameters).backward()
    for name, parameter in parameters.items():
        found = parameter.grad.numpy().reshape(-1)
        places = np.argsort(-np.abs(found))
        places = np.concatenate([places[: MOST // 2], places[MOST // 2 :: 1 + len(places) // (MOST // 2)]])
        wanted = np.array([slope(function, values, name, place) for place in places])
        scale = np.abs(wanted).max()
        assert scale > 0, name
        away = np.abs(found[places] - wanted) / scale
        assert (away <= 1e-4).mean() >= 0.9, (name, away.max())


def brightness(image: Any) -> Any:
    """Return a number to which every pixel and channel contributes otherwise."""
    weights = torch.from_numpy(np.random.default_rng(9).uniform(0.5, 1.5, tuple(image.shape)))
    return (image * weights).sum()


@pytest.mark.parametrize(
    ("rasterizer", "gamma", "rescale"), [("2D", 1.0, False), ("3D", 1.0, False), ("3D", 3.0, True)]
)
def test_two_dts(rasterizer: str, gamma: float, rescale: bool) -> None:
    settings = {"rasterizer": rasterizer, "sh_degree": 2, "gamma": gamma, "gamma_rescale": rescale}
    settings |= {"back_culling": False, "ste_threshold": None, "render_up_scale": None}
    check(
        lambda p: brightness(two_dts.draw(p, CAMERA, BACKGROUND, settings).image),
        soup(("_vertex", "_opacity", "_f_dc", "_f_rest")),
    )


def test_triangle_splatting() -> None:
    settings = {"sh_degree": 2, "view_dir": "broadcast_z"}
    values = soup(("triangles_points", "opacity", "features_dc", "features_rest"))
    values["sigma"] = np.linspace(-0.3, 0.6, 5)[:, None]
    check(lambda p: brightness(triangle_splatting.draw(p, CAMERA, BACKGROUND, settings).image), values)


def test_mesh_splatting() -> None:
    indices = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 0], [1, 4, 2]])
    values = soup(("triangles_points", "vertex_weight", "features_dc", "features_rest"))
    values["triangles_points"] = values["triangles_points"][:, 0]
    settings = {"sh_degree": 1, "supersample": 2, "opacity_floor": 0.1, "sigma": 0.8}
    values["features_rest"] = values["features_rest"][:, :3]
    check(lambda p: brightness(mesh_splatting.draw(p, indices, CAMERA, BACKGROUND, settings).image), values)


def lattice_soup(level: int) -> dict[str, np.ndarray]:
    random, faces = np.random.default_rng(5), 4
    values = {
        "V": triangles(faces, 3).reshape(-1, 3),
        "feat_acc": random.uniform(0, 1, (faces, node_count(level), 7)),
        "alpha_acc": random.uniform(0.6, 0.9, (faces, node_count(level), 1)),
    }
    for layer, shape in {"mlp.0": (16, 16), "mlp.2": (16, 16), "mlp.4": (3, 16)}.items():
        values[f"{layer}.weight"] = random.normal(0, 0.4, shape)
        values[f"{layer}.bias"] = random.normal(0, 0.1, shape[0])
    return values


INDICES = np.arange(12).reshape(4, 3)
PLANES = {"layout": "colmap", "z_near": 0.5, "z_far": 100.0}


def test_diffsoup_cut_at_one_half_is_differentiable_but_for_opacity() -> None:
    values = lattice_soup(1)
    opacity = values.pop("alpha_acc")

    def drawn(parameters: dict[str, Any]) -> Any:
        whole = parameters | tensors({"alpha_acc": opacity})
        return brightness(diffsoup.draw(whole, INDICES, 1, CAMERA, BACKGROUND, PLANES).image)

    check(drawn, values)


def test_diffsoup_expected() -> None:
    wanted = torch.full((CAMERA.height, CAMERA.width, 3), 0.4, dtype=torch.float64)

    def drawn(parameters: dict[str, Any]) -> Any:
        found: Any = diffsoup.draw(parameters, INDICES, 1, CAMERA, BACKGROUND, PLANES, wanted)
        return brightness(found.image) + 100 * found.l1

    check(drawn, lattice_soup(1))


def test_expectation_is_the_mean_of_what_drawn_thresholds_show() -> None:
    """The estimator's claim: thresholds and places within a pixel drawn, images shown, their mean taken."""
    parameters = tensors(lattice_soup(1))
    wanted = torch.full((CAMERA.height, CAMERA.width, 3), 0.4, dtype=torch.float64)
    random = np.random.default_rng(0)
    kept: dict[str, Any] = {}

    def watched(alpha: Any, color: Any, pairs: Any, **how: Any) -> Any:
        if len(color) == 4:
            kept.update(alpha=alpha.detach().numpy(), color=color.detach().numpy(), pairs=pairs)
        return composite(alpha, color, pairs, **how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diffsoup, "composite", watched)
        found: Any = diffsoup.draw(parameters, INDICES, 1, CAMERA, BACKGROUND, PLANES, wanted)
    alpha, color, ranks = kept["alpha"], kept["color"], kept["pairs"].ranks
    draws, images, losses = 800, 0.0, 0.0
    for _ in range(draws):
        # A fragment is there with the probability alpha; each pixel shows the nearest that is.
        there = (random.random(len(alpha)) < alpha)[ranks.pair]
        shown = np.repeat(BACKGROUND[None], CAMERA.height * CAMERA.width, 0)
        free = np.ones(len(ranks.pixels), bool)
        for part, size in ranks.slices():
            takes = there[part] & free[:size]
            shown[ranks.pixels[:size][takes]] = color[:3, ranks.pair[part][takes]].T
            free[:size] &= ~takes
        images = images + shown / draws
        losses = losses + np.abs(shown - 0.4).mean() / draws
    expected = found.image.detach().numpy().reshape(-1, 3)
    assert np.abs(images - expected).max() < 0.08
    assert losses == pytest.approx(found.l1.item(), abs=4e-3)
